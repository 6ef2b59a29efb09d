//! The plate of a new cell: as it is stated, and as sphere centres.

use std::path::PathBuf;
use std::str::FromStr;

use nalgebra::Vector3;
use spherecal_model::CalibrationPlate;
use spherecal_model::input::read_plate_file;

use super::{LARGEST_MM, NewCellError, refuse, text};

/// Height of the plate's triangle below which its spheres count as on one line, in mm.
const FLAT_MM: f64 = 5.0;

/// How the user states the plate.
#[derive(Clone, Debug, PartialEq)]
pub enum StatedPlate {
    /// Table 1 of the paper.
    Paper,
    /// Three spheres by their distances 1-2, 1-3 and 2-3, in mm.
    Distances([f64; 3]),
    /// The spheres' centres, in mm.
    Centres(Vec<[f64; 3]>),
    /// A plate file, as `identify --plate` takes it.
    File(PathBuf),
}

/// A plate as its certificate states it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CertifiedPlate {
    /// What the certificate calls it; may be empty.
    pub(super) name: String,
    /// Centres in the plate's frame, in mm; sphere 1 comes first.
    pub(super) spheres_mm: Vec<[f64; 3]>,
    /// Standard uncertainty of each coordinate, in mm.
    pub(super) sigma_mm: f64,
}

impl FromStr for StatedPlate {
    type Err = NewCellError;

    /// `paper`; `D12,D13,D23`; `X,Y,Z;X,Y,Z;X,Y,Z`; anything else is a file.
    fn from_str(text: &str) -> Result<Self, NewCellError> {
        let text = text.trim();
        if text == "paper" {
            return Ok(Self::Paper);
        }
        let numbers = !text.is_empty() && text.chars().all(|c| c.is_ascii_digit() || "+-.,;eE ".contains(c));
        if !numbers {
            return if text.is_empty() {
                Err(unclear(text))
            } else {
                Ok(Self::File(text.into()))
            };
        }
        if text.contains(';') {
            let centres: Option<Vec<_>> = text.split(';').map(three).collect();
            return centres.map(Self::Centres).ok_or_else(|| unclear(text));
        }
        three(text).map(Self::Distances).ok_or_else(|| unclear(text))
    }
}

fn unclear(value: &str) -> NewCellError {
    refuse(
        "--plate",
        format!("\"{}\"", spherecal_model::excerpt(value)),
        "give the distances of the centres 1-2, 1-3 and 2-3 in mm (300.009,300.24,300.08), the centres in mm \
         (0,0,0;300,0,0;150,260,0), a plate file, or paper",
    )
}

/// Three finite numbers.
fn three(text: &str) -> Option<[f64; 3]> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|word| word.trim().parse().ok().filter(|x: &f64| x.is_finite()))
        .collect::<Option<_>>()?;
    numbers.try_into().ok()
}

impl StatedPlate {
    /// The centres, checked against spheres of a diameter (mm).
    pub(super) fn spheres(&self, diameter_mm: f64) -> Result<CertifiedPlate, NewCellError> {
        let default = CalibrationPlate::default();
        let mut plate = CertifiedPlate {
            name: String::new(),
            spheres_mm: Vec::new(),
            sigma_mm: default.certificate_sigma_m * 1e3,
        };
        match self {
            Self::Paper => plate.spheres_mm = default.spheres_m.iter().map(|s| s.map(|m| m * 1e3)).collect(),
            Self::Distances(distances) => plate.spheres_mm = triangle(*distances)?,
            Self::Centres(centres) => plate.spheres_mm.clone_from(centres),
            Self::File(path) => {
                let read = read_plate_file(path)?;
                if read.spheres.iter().zip(1..).any(|(sphere, id)| sphere.id != id) {
                    return Err(refuse(
                        "--plate",
                        path.display(),
                        "its spheres are numbered otherwise: number them 1, 2, 3, ... in this order",
                    ));
                }
                plate.name = read.name;
                plate.spheres_mm = read.spheres.iter().map(|s| s.position_m.map(|m| m * 1e3)).collect();
                plate.sigma_mm = read.spheres.iter().map(|s| s.sigma_m).fold(0.0, f64::max) * 1e3;
            }
        }
        check(&plate.spheres_mm, diameter_mm)?;
        Ok(plate)
    }
}

/// Three spheres with these distances 1-2, 1-3 and 2-3: sphere 1 in the origin, sphere 2 on x, sphere
/// 3 in the plane of x and y.
fn triangle(distances: [f64; 3]) -> Result<Vec<[f64; 3]>, NewCellError> {
    let [a, b, c] = distances;
    let given = || text::list(distances, 4);
    if let Some(wrong) = distances.into_iter().find(|d| !(*d > 0.0 && *d <= LARGEST_MM)) {
        return Err(refuse(
            "--plate",
            given(),
            format!("{wrong} is no distance of two centres: give millimetres, above 0 and at most {LARGEST_MM}"),
        ));
    }
    let x = (a * a + b * b - c * c) / (2.0 * a);
    let squared = b * b - x * x;
    if squared <= 0.0 {
        let longest = a.max(b).max(c);
        return Err(refuse(
            "--plate",
            given(),
            format!(
                "no triangle has these sides: {longest} is not shorter than the two others together, {}. Give the \
                 distances of the centres 1-2, 1-3 and 2-3 in mm",
                text::number(a + b + c - longest, 4)
            ),
        ));
    }
    Ok(vec![[0.0; 3], [a, 0.0, 0.0], [x, squared.sqrt(), 0.0]])
}

/// Refuses spheres that are too few, touch each other, are too far away, or lie on one line.
fn check(spheres_mm: &[[f64; 3]], diameter_mm: f64) -> Result<(), NewCellError> {
    let centres: Vec<Vector3<f64>> = spheres_mm.iter().map(|s| Vector3::from(*s)).collect();
    let (Some(first), true) = (centres.first(), centres.len() >= 3) else {
        return Err(refuse(
            "--plate",
            format!("{} spheres", centres.len()),
            "a plate has three spheres or more",
        ));
    };
    for (i, a) in centres.iter().enumerate() {
        for (j, b) in centres.iter().enumerate().take(i) {
            let distance = (a - b).norm();
            if !(distance > diameter_mm && distance <= LARGEST_MM) {
                return Err(refuse(
                    "--plate",
                    format!(
                        "{} mm from sphere {} to sphere {}",
                        text::number(distance, 3),
                        j + 1,
                        i + 1
                    ),
                    format!(
                        "two spheres of {diameter_mm} mm have centres that are farther apart, and within {LARGEST_MM} \
                         mm: give the certificate's numbers in mm"
                    ),
                ));
            }
        }
    }
    let far = centres
        .iter()
        .map(|c| c - first)
        .max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let along = far.unwrap_or_default().normalize();
    let height = centres
        .iter()
        .map(|c| (c - first - along * along.dot(&(c - first))).norm())
        .fold(0.0, f64::max);
    if height < FLAT_MM {
        return Err(refuse(
            "--plate",
            format!(
                "{} spheres within {} mm of one line",
                centres.len(),
                text::number(height, 2)
            ),
            "the plate's turn about that line could not be told: check the numbers of the certificate",
        ));
    }
    Ok(())
}
