//! What crosses a boundary: the host and drive links and their documentation,
//! and how the crates are built for the target.

mod board_drive;
mod cross_routes;
mod drive_link_page;
mod handshake;
mod hostile_peers;
mod lossy_link;
mod mujoco_drive;
mod no_std_tree;
mod serial_link;
mod tcp_link;
mod wire_faults;
