//! A simulated cabinet with an LBR arm for any client of the Fast Robot Interface.
//!
//! ```console
//! $ cargo run -p spherecal-fri --example fri_cabinet -- --client 127.0.0.1:30200 --tolerant --command
//! ```

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal_fri::robot::{CabinetConfig, START, Tolerance, joint_arm, start_cabinet};

const HELP: &str = "\
Simulates a cabinet with seven independent joints, joint impedance with stiffness and damping 0, torque overlay.

usage: fri_cabinet [--client IP:PORT] [--period-ms N] [--receive-multiplier N] [--command] [--tolerant] [--seconds N]

  --client IP:PORT        where the client listens (default 127.0.0.1:30200)
  --period-ms N           time between two messages, 1 to 100 ms (default 1)
  --receive-multiplier N  expect an answer to each n-th message (default 1)
  --command               start the application's motion as soon as the connection is good
  --tolerant              wait up to 100 ms for each answer while commanding: for machines without real time.
                          A real cabinet does not wait.
  --seconds N             end after N seconds (default: never)
";

fn main() -> std::process::ExitCode {
    let mut config = CabinetConfig::new();
    let (mut seconds, mut command) = (u64::MAX, false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_default();
        let in_range = |n: &u32| (1..=100).contains(n);
        let understood = match argument.as_str() {
            "--client" => value().parse::<SocketAddr>().map(|a| config.client = a).is_ok(),
            "--period-ms" => {
                let period = value().parse().ok().filter(in_range);
                period.map(|p| config.send_period_ms = p).is_some()
            }
            "--receive-multiplier" => {
                let multiplier = value().parse().ok().filter(in_range);
                multiplier.map(|m| config.receive_multiplier = m).is_some()
            }
            "--command" => {
                command = true;
                true
            }
            "--tolerant" => {
                config.tolerance = Tolerance::tolerant();
                true
            }
            "--seconds" => value().parse().map(|s| seconds = s).is_ok(),
            "--help" => {
                print!("{HELP}");
                return std::process::ExitCode::SUCCESS;
            }
            _ => false,
        };
        if !understood {
            eprintln!("cannot understand {argument}\n\n{HELP}");
            return std::process::ExitCode::from(2);
        }
    }
    let client = config.client;
    let side = match start_cabinet(config, Box::new(joint_arm(START))) {
        Ok(side) => side,
        Err(error) => {
            eprintln!("cannot open a UDP port: {error}");
            return std::process::ExitCode::from(1);
        }
    };
    side.controls().command.store(command, Ordering::Relaxed);
    println!("sending to {client}");
    std::thread::sleep(Duration::from_secs(seconds));
    println!("{:?}", side.shut_down());
    std::process::ExitCode::SUCCESS
}
