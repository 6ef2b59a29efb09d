//! A device or a drive in a box is one.

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::protocol::host::LoopTiming;

use super::{Device, Drive, KeepAlives, LinkError, native};

impl<D: Device + ?Sized> Device for Box<D> {
    fn waits(&self) -> bool {
        (**self).waits()
    }

    fn simulated(&self) -> Option<bool> {
        (**self).simulated()
    }

    fn now_us(&self) -> u64 {
        (**self).now_us()
    }

    fn ticks(&self) -> u64 {
        (**self).ticks()
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        (**self).step(down, up)
    }

    fn move_plate(&mut self, place: u32) -> bool {
        (**self).move_plate(place)
    }

    fn monitor(&self) -> Option<native::Monitor> {
        (**self).monitor()
    }

    fn keep_alive(&mut self, keep_alives: &KeepAlives) {
        (**self).keep_alive(keep_alives);
    }
}

impl<D: Drive + ?Sized> Drive for Box<D> {
    fn hello(&self) -> &DriveHello {
        (**self).hello()
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        (**self).exchange(command, state)
    }

    fn answer(&mut self, command: &DriveCommand) -> Result<(), LinkError> {
        (**self).answer(command)
    }

    fn missed(&self) -> u32 {
        (**self).missed()
    }

    fn timing(&self) -> Option<LoopTiming> {
        (**self).timing()
    }

    fn move_plate(&mut self, place: u32) -> bool {
        (**self).move_plate(place)
    }

    fn counters(&self) -> LinkCounters {
        (**self).counters()
    }

    fn monitor(&self) -> Option<native::Monitor> {
        (**self).monitor()
    }
}
