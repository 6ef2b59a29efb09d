//! Drives over the interfaces of robots, and the example of a drive.

mod drive_example;
mod franka_drive;
mod kuka_drive;
mod ur_drive;
mod ur_reader;
