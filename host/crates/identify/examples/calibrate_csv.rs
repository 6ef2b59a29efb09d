//! Calibrates a robot from a CSV file.
//!
//! `cargo run -p spherecal-identify --example calibrate_csv -- ROBOT DATA.csv [PLATE.toml]`;
//! without arguments, an iiwa 14 from contacts with two sockets.

use spherecal_identify::study::{StudyRequest, study};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let here = env!("CARGO_MANIFEST_DIR");
    let mut arguments = std::env::args().skip(1);
    let request = match (arguments.next(), arguments.next()) {
        (Some(robot), Some(data)) => StudyRequest {
            robot,
            data: data.into(),
            plate: arguments.next().map(Into::into),
            ..StudyRequest::default()
        },
        _ => StudyRequest {
            robot: format!("{here}/../../../tests/data/iiwa14.urdf"),
            data: format!("{here}/../../../tests/data/mukca_iiwa14.csv").into(),
            plate: Some(format!("{here}/examples/sockets.toml").into()),
            ..StudyRequest::default()
        },
    };
    let found = study(&request, &mut |_| {})?.evaluation;
    for p in found.calibration.parameters.iter().filter(|p| p.identified) {
        println!(
            "{:12} {:+.6} ± {:.6} {:?}",
            p.name,
            p.estimate - p.nominal,
            p.sigma,
            p.unit
        );
    }
    println!("may be used: {}", found.verdict.may_be_used);
    found.verdict.reasons.iter().for_each(|reason| println!("- {reason}"));
    Ok(())
}
