//! Peers that connect and say nothing.

use std::io::Read as _;
use std::net::TcpStream;
use std::thread;
use std::time::Duration;

use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::frame::{self, MAX_FRAME, Message};
use spherecal_shared::protocol::host::{Command, Downlink};

use super::*;
use crate::tcp::conform::tests::Still;
use crate::tcp::controller_server::{HostService, serve_hosts};
use crate::tcp::{DriveServer, Remote, RemoteDrive, listen};
use crate::{Device as _, Drive as _, LocalDevice, controller_in_process};

fn framed<M: Message>(message: &M) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = frame::encode(message, 0, 0, &mut out).expect("it fits");
    out[..length].to_vec()
}

/// What a host says.
fn keep_alive() -> Downlink {
    Downlink {
        session: [7; 4],
        sequence: 0,
        start_us: 0,
        command: Command::KeepAlive,
    }
}

/// So many connections that say nothing, and one that sends an end mark now and then.
fn crowd(address: SocketAddr) -> Vec<TcpStream> {
    let silent: Vec<TcpStream> = (0..20)
        .map(|_| TcpStream::connect(address).expect("connects"))
        .collect();
    let mut marks = TcpStream::connect(address).expect("connects");
    thread::spawn(move || {
        while marks.write_all(&[0]).is_ok() {
            thread::sleep(Duration::from_millis(50));
            marks.set_nonblocking(true).expect("set");
            let _ = marks.read(&mut [0; 4096]);
            marks.set_nonblocking(false).expect("set");
        }
    });
    // They have connected before the honest one does.
    thread::sleep(Duration::from_millis(300));
    silent
}

// Fails if peers that connect and say nothing, or send end marks alone, keep an honest one from a plant or from a
// controller, in lock-step or in real time.
#[test]
fn silent_peers_keep_nobody_out() {
    for real_time in [false, true] {
        let (listener, address) = listen("0").expect("a free port");
        thread::spawn(move || {
            let mut server = DriveServer::new(Box::new(Still::new()), real_time);
            loop {
                let _ = server.serve(&listener);
            }
        });
        let silent = crowd(address);
        let mut drive = RemoteDrive::connect(&address.to_string()).expect("the plant answers");
        let (mut state, mut first) = (DriveState::default(), 0);
        for _ in 0..20 {
            let command = DriveCommand {
                session: drive.hello().session,
                tick: state.tick,
                tau: state.tau.clone(),
                enable: false,
                ..DriveCommand::default()
            };
            let answer = (!state.q.is_empty()).then_some(&command);
            drive.exchange(answer, &mut state).expect("the plant serves");
            first = if first == 0 { state.tick } else { first };
        }
        assert!(
            state.tick > first,
            "real time {real_time}: another controller is served"
        );
        drop(silent);
    }
    for drive in [Still::new(), Still::in_real_time()] {
        let (listener, address) = listen("0").expect("a free port");
        thread::spawn(move || {
            let controller = controller_in_process(7).expect("built");
            let mut cell = LocalDevice::new(controller, Box::new(drive), 7).expect("it fits");
            let _ = serve_hosts(&mut cell, &listener, false, &mut |_| ());
        });
        let silent = crowd(address);
        let mut host = Remote::connect(&address.to_string(), 7).expect("the controller answers");
        let frame = framed(&keep_alive());
        for _ in 0..20 {
            host.step(&frame, &mut Vec::new()).expect("the controller serves");
        }
        drop(silent);
    }
}

// Fails if a host that was held up for so long that the controller has disconnected it and holds the arm cannot go on
// with that controller, or if it tries again and again where the controller has ended.
#[test]
fn a_host_that_was_disconnected_comes_back() {
    let (listener, address) = listen("0").expect("a free port");
    let (out, left) = std::sync::mpsc::channel();
    let (stop, stopped) = std::sync::mpsc::channel::<()>();
    let controller = thread::spawn(move || {
        let controller = controller_in_process(7).expect("built");
        let mut cell = LocalDevice::new(controller, Box::new(Still::in_real_time()), 7).expect("it fits");
        let patience = Some(Duration::from_millis(300));
        let mut service = HostService::with_patience(&listener, patience).expect("a listener");
        while stopped.try_recv().is_err() {
            service.turn(&mut cell).expect("a period");
            if let Some(reason) = service.reason() {
                out.send(reason.to_string()).expect("heard");
            }
            thread::sleep(Duration::from_millis(1));
        }
    });
    let mut host = Remote::connect(&address.to_string(), 7).expect("the controller answers");
    let frame = framed(&keep_alive());
    for _ in 0..3 {
        for _ in 0..20 {
            host.step(&frame, &mut Vec::new()).expect("the controller serves");
        }
        let reason = left.recv_timeout(Duration::from_mins(1)).expect("it is left");
        assert!(reason.contains("no valid frame"), "{reason}");
    }
    let ticks = host.ticks();
    host.step(&frame, &mut Vec::new()).expect("it goes on");
    assert!(host.ticks() > ticks);
    stop.send(()).expect("it runs");
    controller.join().expect("no panic");
    let ended = std::iter::repeat_with(|| host.step(&frame, &mut Vec::new()).err())
        .flatten()
        .next();
    assert!(ended.expect("an error").to_string().contains("closed the connection"));
}
