//! The texts of a new cell: `cell.toml`, `plate.toml`, `poses.csv`. Numbers are rounded to what an
//! instrument resolves.

use std::fmt::Write as _;

use super::{Decided, Instrument};

/// A number with at most `decimals` decimals, without zeros at its end, as a TOML float.
pub(super) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = text.trim_end_matches('0');
    let text = if text.ends_with('.') {
        format!("{text}0")
    } else {
        text.to_owned()
    };
    match text.as_str() {
        "-0.0" => "0.0".to_owned(),
        _ => text,
    }
}

/// `X,Y,Z`, as an option takes it.
pub(super) fn list(values: [f64; 3], decimals: usize) -> String {
    let short = |value: f64| {
        let text = number(value, decimals);
        text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
    };
    values.map(short).join(",")
}

/// `[x, y, z]`, as TOML has it.
fn array(values: [f64; 3], decimals: usize) -> String {
    format!("[{}]", values.map(|v| number(v, decimals)).join(", "))
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

impl Decided<'_> {
    /// The configuration, with comments that teach.
    pub(super) fn cell_toml(&self) -> String {
        let stated = self.stated;
        let mut out = String::new();
        let mm = |metres: f64| metres * 1e-3;
        let spheres: String = self
            .plate
            .spheres_mm
            .iter()
            .map(|s| format!("    {},\n", array(s.map(mm), 7)))
            .collect();
        let plate_certificate = match self.certificate() {
            "" => "# plate_certificate = \"\"".to_owned(),
            name => format!("plate_certificate = {}", quoted(name)),
        };
        let instrument = match stated.instrument {
            Instrument::None => "none but the plate: contacts with its spheres are all that is measured",
            Instrument::Tracker => "a laser tracker",
            Instrument::Points => "an instrument that measures points",
        };
        let _ = write!(
            out,
            "# The cell of one arm, written by `spherecal init`. Change what is not true of yours, and check it with\n\
             # `spherecal config --config cell.toml`. Fields that are left out have their defaults: `spherecal config --print`\n\
             # shows all of them. Lengths are in m and angles in rad, unless the name says otherwise.\n\
             \n\
             # The robot: a built-in name (`spherecal robot list`), or the path of a .toml, .urdf or .yaml file.\n\
             robot = {robot}\n\
             # This very arm, by its serial number. `spherecal history` and `trend` tell arms apart by it.\n\
             arm = {arm}\n\
             # Instrument: {instrument}.\n\
             \n\
             # The tool: everything that is mounted on the flange, with the magnetic nest.\n\
             [cell.tool]\n\
             # Its mass, in kg. The load of the joints is computed from it.\n\
             mass_kg = {mass}\n\
             # Its centre of mass in the flange frame, in mm.\n\
             com_mm = {com}\n\
             # The TCP: the centre of a sphere that sits in the nest, in the flange frame, in mm. The\n\
             # drawing's value is enough: the calibration estimates it anew.\n\
             tcp_mm = {tcp}\n\
             \n\
             # The plate. Its certificate gives the calibration its scale.\n\
             [cell.plate]\n\
             # Centres of the spheres in the plate's own frame; sphere 1 comes first.\n\
             spheres_m = [\n{spheres}]\n\
             # Standard uncertainty of each coordinate (1 sigma): half of the certificate's U at k = 2.\n\
             certificate_sigma_m = {sigma:.2e}\n\
             # Radius of the spheres.\n\
             sphere_radius_m = {radius}\n\
             \n\
             # Where the plate stands: the position of sphere 1 in the robot's base frame, and roll, pitch and yaw of the plate. The\n\
             # arm finds a sphere within 10 mm of its place; `spherecal teach` stores a better start for each. A second\n\
             # [[cell.placements]] table makes the run stop, so that you can move the plate.\n\
             [[cell.placements]]\n\
             origin_m = {origin}\n\
             rpy_rad = {rpy}\n\
             \n\
             # What `spherecal certificate` needs and cannot know: take the # away before a line that you fill in. It is all\n\
             # that ISO/IEC 17025 asks for; a draft may lack some of it.\n\
             [certificate]\n\
             # number = \"\"\n\
             # customer = \"\"\n\
             # customer_address = \"\"\n\
             # laboratory = \"\"\n\
             # laboratory_address = \"\"\n\
             # Where the robot stands: building, room, cell.\n\
             # place = \"\"\n\
             # operator = \"\"\n\
             # Who authorises the certificate, and signs it.\n\
             # authorised_by = \"\"\n\
             # Temperature at the robot during the measurement, in degrees Celsius.\n\
             # temperature_c = 20.0\n\
             # For measured points: the instrument, the number of its certificate, and the day as YYYY-MM-DD.\n\
             # instrument = \"\"\n\
             # instrument_certificate = \"\"\n\
             # measured_on = \"2026-11-28\"\n\
             # For contacts: the plate, and the number of its certificate.\n\
             # plate = \"\"\n\
             {plate_certificate}\n\
             # Months to the next calibration, as agreed with the customer.\n\
             # validity_months = 12\n",
            robot = quoted(&self.robot),
            arm = quoted(stated.serial.trim()),
            mass = number(stated.tool_mass_kg, 4),
            com = array(self.com_mm, 3),
            tcp = array(self.tool_mm, 3),
            sigma = mm(self.plate.sigma_mm),
            radius = number(mm(stated.sphere_diameter_mm / 2.0), 6),
            origin = array(self.placement.origin_m, 4),
            rpy = array(self.placement.rpy_rad, 4),
        );
        out
    }

    /// The number of the plate's certificate; empty if nobody stated it.
    fn certificate(&self) -> &str {
        let stated = self.stated.plate_certificate.trim();
        if stated.is_empty() { &self.plate.name } else { stated }
    }

    /// The plate's file.
    pub(super) fn plate_toml(&self) -> String {
        let mut out = String::from(
            "# The plate by its certificate, for `spherecal identify --plate`. The same numbers are in cell.toml, in m.\n\
             # sigma_mm: standard uncertainty of each coordinate (1 sigma), half of the certificate's U at k = 2.\n",
        );
        if !self.certificate().is_empty() {
            let _ = writeln!(out, "name = {}", quoted(self.certificate()));
        }
        for (sphere, id) in self.plate.spheres_mm.iter().zip(1..) {
            let [x, y, z] = sphere.map(|v| number(v, 4));
            let _ = write!(
                out,
                "\n[[sphere]]\nid = {id}\nx_mm = {x}\ny_mm = {y}\nz_mm = {z}\nsigma_mm = {}\n",
                number(self.plate.sigma_mm, 6)
            );
        }
        out
    }

    /// The header row of the table of poses.
    pub(super) fn poses_csv(&self) -> String {
        let unit = if self.stated.degrees { "_deg" } else { "" };
        let mut columns: Vec<String> = (1..=self.model.robot.joints.len())
            .map(|joint| format!("q{joint}{unit}"))
            .collect();
        let measured: &[&str] = match self.stated.instrument {
            Instrument::None => &["sphere"],
            Instrument::Tracker | Instrument::Points => &["x_mm", "y_mm", "z_mm"],
        };
        columns.extend(measured.iter().map(|&name| name.to_owned()));
        columns.join(",") + "\n"
    }

    /// `--tool-mm ...` and so on for `identify`.
    pub(super) fn identify_options(&self) -> String {
        format!(
            "--tool-mm {} --payload-kg {} --payload-com-mm {}",
            list(self.tool_mm, 3),
            number(self.stated.tool_mass_kg, 4),
            list(self.com_mm, 3)
        )
    }

    /// What is assumed of the plate's place.
    pub(super) fn place_words(&self) -> String {
        format!(
            "sphere 1 is at {} mm in the base frame, the plate is turned by {} degrees, which is within reach: measure yours, and \
             correct [[cell.placements]]",
            list(self.placement.origin_m.map(|m| m * 1e3), 1),
            number(self.placement.rpy_rad[2].to_degrees(), 1)
        )
    }
}
