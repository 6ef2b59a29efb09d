//! The controller's image and those at its links: who it is, drives that are
//! foreign, hosts and images that fall silent, bytes on a UART.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use spherecal::link::Controller;
use spherecal::link::qemu::{Machine, Qemu, QemuError, QemuOptions, find_qemu, qemu_arguments};
use spherecal_firmware::Node;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello};
use spherecal_shared::protocol::frame::{self, Accumulator};
use spherecal_shared::protocol::host::{Command as Order, Downlink, Event, Fault, Uplink};
use spherecal_tests::bench::{HOME, framed, handshake_commands, hello, spread, state};
use spherecal_tests::qemu::{bench, image, log_of, options};

// Fails if the image does not boot, does not greet, or says another version,
// number of joints or protocol than this program's.
#[test]
fn it_boots_and_says_who_it_is() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = bench(&options(&image, folder.path()), &HOME);
    let command = bench.step();
    assert!(command.enable && command.tau.len() == 7);
    let banner = bench.banner().expect("a banner");
    assert_eq!(
        (banner.protocol, banner.joints, banner.period_us),
        (PROTOCOL_VERSION, 7, 1000)
    );
    assert_eq!(banner.version.as_str(), env!("CARGO_PKG_VERSION"));
    assert!(
        !["", "unknown", "in-process"].contains(&banner.build.as_str()),
        "{}",
        banner.build
    );
    let log = log_of(bench, folder.path());
    assert!(
        log.contains(banner.build.as_str()) && log.contains("drive: 7 joints"),
        "{log}"
    );
    assert!(!log.contains("could not be decoded"), "{log}");
}

// Fails if a drive of another protocol is worked with, or refused without a word.
#[test]
fn a_foreign_drive_is_refused() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let mut qemu = Qemu::start(&options(&image, folder.path())).expect("QEMU starts");
    let foreign = DriveHello {
        protocol: PROTOCOL_VERSION + 1,
        ..hello()
    };
    qemu.connect(&foreign).expect("a hello that fits");
    let error = qemu
        .exchange(0, &state(0, &HOME, &[0.0; 7], &[0.0; 7]), &[], &mut Vec::new())
        .expect_err("a foreign drive");
    assert!(error.to_string().contains("refuses the drive"), "{error}");
}

// Fails if a host that falls silent in a motion is not a fault after 2 s, or if
// the arm is let go instead of held.
#[test]
fn a_silent_host_is_a_fault_and_the_arm_is_held() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = bench(&options(&image, folder.path()), &HOME);
    bench.order(Order::HandGuide { on: true });
    bench.still(&HOME);
    bench.alive = false;
    let mut ticks = 0;
    while bench.fault().is_none() && ticks < 2500 {
        bench.still(&HOME);
        ticks += 1;
    }
    assert_eq!(bench.fault(), Some(Fault::HostSilence));
    assert!((1990..=2010).contains(&ticks), "after {ticks} ms");
    let held = bench.still(&HOME);
    assert!(held.enable && held.tau[1].abs() > 5.0, "gravity is held: {held:?}");
}

// Fails if an image that says nothing is waited for without end.
#[test]
fn a_silent_controller_is_ended() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let options = QemuOptions {
        scenario: "uart".to_owned(),
        patience: Duration::from_secs(2),
        ..options(&image, folder.path())
    };
    let mut qemu = Qemu::start(&options).expect("QEMU starts");
    let error = qemu
        .exchange(0, &state(0, &HOME, &[0.0; 7], &[0.0; 7]), &[], &mut Vec::new())
        .expect_err("the image does not listen");
    assert!(error.to_string().contains("did not answer for 2 s"), "{error}");
}

// Fails if a byte of either link is lost or changed on its way through the
// UARTs' interrupts, or if a torque differs in any bit.
#[test]
fn the_uarts_carry_both_links() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let socket = |name: &str| folder.path().join(name);
    let chardev = |id: &str| format!("socket,id={id},path={},server=on,wait=off", socket(id).display());
    let mut arguments = qemu_arguments(&image, Machine::CortexM7, 3, &["uart".to_owned()]);
    // Real bytes want real time: no instruction counting.
    let icount = arguments.iter().position(|a| a == "-icount").expect("it is there");
    arguments.drain(icount..icount + 2);
    arguments.retain(|a| a != "-serial" && a != "null");
    let mut child = Command::new(find_qemu().expect("QEMU"))
        .args(arguments)
        .args(["-chardev", &chardev("drive"), "-serial", "chardev:drive"])
        .args(["-chardev", &chardev("host"), "-serial", "chardev:host"])
        .stdin(Stdio::null())
        .spawn()
        .expect("QEMU starts");
    let connect = |name: &str| {
        let until = Instant::now() + Duration::from_secs(20);
        loop {
            match UnixStream::connect(socket(name)) {
                Ok(stream) => {
                    stream
                        .set_read_timeout(Some(Duration::from_secs(20)))
                        .expect("a timeout");
                    return stream;
                }
                Err(error) => assert!(Instant::now() < until, "{error}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let (mut drive, mut host) = (connect("drive"), connect("host"));
    let mut node = Box::new(Node::<7>::default());
    node.controller().connect(&hello()).expect("a drive that fits");
    drive.write_all(&framed(&hello(), 0)).expect("written");
    // The robot is nearly 2 kB, more than one read of the image.
    let down = handshake_commands(Procedure::default())
        .into_iter()
        .zip(1..)
        .flat_map(|(command, sequence)| framed(&Downlink::at_once(sequence, command), sequence))
        .collect::<Vec<_>>();
    host.write_all(&down).expect("written");
    let mut greeted = Accumulator::new();
    let (mut answers, mut seed, mut configured) = (Accumulator::new(), 7, false);
    for tick in 0..400u64 {
        let q = HOME.map(|x| x + 1e-3 * spread(&mut seed));
        let dq = [0; 7].map(|_| 1e-2 * spread(&mut seed));
        let state = state(tick, &q, &dq, &[0.0; 7]);
        drive.write_all(&framed(&state, tick as u32 + 1)).expect("written");
        let (mut command, mut byte) = (None, [0]);
        while command.is_none() {
            drive.read_exact(&mut byte).expect("an answer");
            answers.push(byte[0], &mut |frame| {
                let frame = frame.expect("no byte is lost");
                command = Some(frame::decode::<DriveCommand>(frame).expect("a command").1);
            });
        }
        let command = command.expect("a command");
        assert_eq!(command.tick, tick);
        // The host's bytes arrive when they arrive: join when they have.
        if !configured && command.enable {
            let mut up = vec![0; 1 << 14];
            configured = true;
            let now = embassy_time::Instant::from_micros(0);
            let (expected, _) = node.exchange(now, &state, &down, &mut up);
            assert_eq!(expected.tau, command.tau, "the first torque");
            continue;
        }
        if configured {
            let mut up = vec![0; 1 << 14];
            let now = embassy_time::Instant::from_micros(0);
            let (expected, _) = node.exchange(now, &state, &[], &mut up);
            assert_eq!(expected.tau, command.tau, "torques at tick {tick}");
        } else {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
    assert!(configured, "the host's commands arrived");
    let (mut banner, mut byte) = (None, [0]);
    while banner.is_none() {
        host.read_exact(&mut byte).expect("a banner");
        greeted.push(byte[0], &mut |frame| {
            let frame = frame.expect("no byte is lost");
            if let Event::Banner(said) = frame::decode::<Uplink>(frame).expect("an uplink").1.body {
                banner = Some(said);
            }
        });
    }
    assert_eq!(banner.map(|b| b.joints), Some(7));
    child.kill().expect("it runs");
    child.wait().expect("it ends");
}

// Fails if a missing image is not said with its remedy.
#[test]
fn a_missing_image_is_said() {
    if find_qemu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let nowhere = folder.path().join("nothing");
    let error = Qemu::start(&options(&nowhere, folder.path())).err().expect("no image");
    assert!(matches!(error, QemuError::NoImage { .. }), "{error}");
}
