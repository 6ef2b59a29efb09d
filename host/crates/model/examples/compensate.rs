//! Corrects joint commands for a controller that keeps its nominal model.
//!
//! ```text
//! cargo run -p spherecal-model --example compensate -- calibrated.toml 0.3,0.6,-0.2,-1.2,0.4,0.9,0.1
//! ```
//!
//! A controller needs `spherecal_shared::robot::compensator` alone: it runs without an operating
//! system and allocates nothing. `docs/compensate.md` has the formula.

use std::error::Error;

use spherecal_model::robots::read_compensator;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(file), Some(angles)) = (arguments.next(), arguments.next()) else {
        return Err("give calibrated.toml and the joint angles in rad, as q1,q2,...".into());
    };
    let compensator = read_compensator(&file, &std::fs::read_to_string(&file)?)?;
    let nominal: Vec<f64> = angles.split(',').map(|q| q.trim().parse()).collect::<Result<_, _>>()?;
    let mut command = nominal.clone();
    compensator.command(&nominal, &mut command)?;
    println!("command (rad): {command:?}");
    let uncorrected = (compensator.tcp_m(&nominal) - compensator.nominal(&nominal).0).norm();
    println!("without it the TCP would be {:.3} mm off", uncorrected * 1e3);
    Ok(())
}
