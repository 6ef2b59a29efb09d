//! The two links and their transports: in-process, QEMU, serial, TCP.
