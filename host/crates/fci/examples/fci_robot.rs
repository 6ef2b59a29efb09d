//! A simulated Panda or FR3 for any client of the Franka Control Interface.
//!
//! ```console
//! $ cargo run -p spherecal-fci --example fci_robot -- --version 10 --tolerant
//! ```

use std::net::SocketAddr;
use std::time::Duration;

use spherecal_fci::robot::{READY, RobotConfig, Tolerance, joint_arm, start_robot};
use spherecal_fci::wire::Version;

const HELP: &str = "\
Simulates a Panda or an FR3 with seven independent joints.

usage: fci_robot [--version 4..10] [--address IP:PORT] [--tolerant] [--seconds N]

  --version N        version of the interface: 4 and 5 are a Panda, 6 to 10 an FR3 (default 10)
  --address IP:PORT  where to listen (default 127.0.0.1:1337; official clients know only port 1337)
  --tolerant         wait up to 100 ms for each answer of a motion: for machines without real time.
                     A real robot does not wait.
  --seconds N        end after N seconds (default: never)
";

fn main() -> std::process::ExitCode {
    let mut config = RobotConfig::new(Version::V10);
    let mut seconds = u64::MAX;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_default();
        let understood = match argument.as_str() {
            "--version" => {
                let version = value().parse().ok().and_then(|n| Version::from_number(n).ok());
                version.map(|v| config.version = v).is_some()
            }
            "--address" => value().parse::<SocketAddr>().map(|a| config.address = a).is_ok(),
            "--seconds" => value().parse().map(|s| seconds = s).is_ok(),
            "--tolerant" => {
                config.tolerance = Tolerance::tolerant();
                true
            }
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
    let version = config.version;
    let side = match start_robot(config, Box::new(joint_arm(READY))) {
        Ok(side) => side,
        Err(error) => {
            eprintln!("cannot listen: {error}; is another robot running?");
            return std::process::ExitCode::from(1);
        }
    };
    println!("interface version {version} at {}", side.address());
    std::thread::sleep(Duration::from_secs(seconds));
    println!("{:?}", side.shut_down());
    std::process::ExitCode::SUCCESS
}
