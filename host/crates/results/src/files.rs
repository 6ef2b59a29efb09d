//! The files of a result: one writer for every calibration.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use spherecal_identify::{Evaluation, Pose};
use spherecal_shared::robot::MdhRow;
use spherecal_shared::robot::compensator::CompensatedJoint;

use crate::WriteError;
use crate::other_robot::keep_other_robots;
use spherecal_model::robots::{RobotModel, toml_file, write_kinematics_yaml, write_offsets_yaml, write_urdf_with_tcp};
use spherecal_model::write_file;

/// Paths of what was written.
#[derive(Clone, Debug, Default)]
pub struct Files {
    /// In the order in which they were written.
    pub paths: Vec<PathBuf>,
    /// What to tell the user of results of another robot, which were moved; `None` without such results.
    pub moved: Option<String>,
}

impl Files {
    /// Writes one file and adds it to the list.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&mut self, folder: &Path, name: &str, text: &str) -> Result<(), WriteError> {
        let path = folder.join(name);
        write_file(&path, text).map_err(WriteError::of(&path))?;
        self.paths.push(path);
        Ok(())
    }
}

/// What is written of a result.
pub struct Results<'a> {
    /// The nominal robot with its files' frames.
    pub nominal: &'a RobotModel,
    /// The tool that was given: its TCP in the last frame of the table (m).
    pub given_tcp_m: [f64; 3],
    /// The calibration and its verdict.
    pub evaluation: &'a Evaluation,
    /// The document that other programs read.
    pub summary: &'a serde_json::Value,
    /// What the files say first: what was calibrated, from what.
    pub origin: String,
    /// The page; `None` if it was not asked for.
    pub report: Option<&'a str>,
}

/// Writes `summary.json`, `calibrated.toml`, `calibrated.urdf`, `kinematics.yaml`,
/// `offsets.yaml` and `report.html` into `folder`, which is made where it does not exist. Results of
/// another robot in it are moved into a folder of their own.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn write_results(folder: &Path, results: &Results<'_>) -> Result<Files, WriteError> {
    std::fs::create_dir_all(folder).map_err(WriteError::of(folder))?;
    let texts = calibrated_texts(results);
    let mut files = Files {
        moved: keep_other_robots(folder, results.summary)?,
        ..Files::default()
    };
    files.put(folder, "summary.json", &format!("{:#}\n", results.summary))?;
    files.put(folder, "calibrated.toml", &texts.toml)?;
    if results.evaluation.geometry.helps() {
        files.put(folder, "calibrated.urdf", &texts.urdf)?;
        files.put(folder, "kinematics.yaml", &texts.kinematics_yaml)?;
        files.put(folder, "offsets.yaml", &texts.offsets_yaml)?;
    } else {
        for name in ["calibrated.urdf", "kinematics.yaml", "offsets.yaml"] {
            // One of an earlier run would be taken for this result.
            let path = folder.join(name);
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(WriteError::of(&path)(error)),
                _ => {}
            }
        }
    }
    if let Some(html) = results.report {
        files.put(folder, "report.html", html)?;
    }
    Ok(files)
}

/// The calibrated robot as the files of a result hold it.
#[derive(Clone, Debug)]
pub struct CalibratedTexts {
    /// Geometry alone, with tool and frames.
    pub model: RobotModel,
    /// `calibrated.toml`.
    pub toml: String,
    /// `calibrated.urdf`.
    pub urdf: String,
    /// `kinematics.yaml`.
    pub kinematics_yaml: String,
    /// `offsets.yaml`.
    pub offsets_yaml: String,
}

/// Writes the calibrated robot as text.
pub(crate) fn calibrated_texts(results: &Results<'_>) -> CalibratedTexts {
    let Results {
        nominal, evaluation, ..
    } = results;
    let alone = &evaluation.geometry;
    let mut model = RobotModel::clone(nominal);
    model.robot = alone.robot.clone();
    model.tool.tcp_m = model.tcp_in_flange(alone.tool.tcp_m);
    let rows = model.rows();
    let notes = notes(results, &model);
    CalibratedTexts {
        toml: toml_file::write(&model, &notes) + &effects_toml(results),
        urdf: write_urdf_with_tcp(nominal, &rows, &notes, &model.tool.tcp_m),
        kinematics_yaml: write_kinematics_yaml(nominal, &rows, &notes),
        offsets_yaml: write_offsets_yaml(nominal, &rows, &notes),
        model,
    }
}

/// What a calibrated file says of its origin: first the error of the file itself, last where its base is.
fn notes(results: &Results<'_>, model: &RobotModel) -> Vec<String> {
    let mut notes = file_notes(results, model);
    notes.push(base_note(&model.frame_names.0, &base_of_files(results.evaluation)));
    notes
}

/// The same without the base.
pub(crate) fn file_notes(results: &Results<'_>, model: &RobotModel) -> Vec<String> {
    let evaluation = results.evaluation;
    let verdict = &evaluation.verdict;
    let mut notes = vec![results.origin.clone()];
    notes.push(match verdict.file_error_mm {
        Some(e) => format!(
            "this file holds geometry alone: expected error {:.3} mm in the mean over the work region (95 % interval {:.3} to \
             {:.3} mm); the full model with its compensator is {:.3} mm from it in the mean",
            e.mean, e.interval[0], e.interval[1], evaluation.geometry.apart_mm
        ),
        None => format!(
            "this file holds geometry alone: {:.3} mm in the mean from the full model",
            evaluation.geometry.apart_mm
        ),
    });
    notes.push(if verdict.may_be_used { "OK to use" } else { "DO NOT USE" }.to_owned());
    notes.push(format!(
        "TCP {} mm in the flange frame {}: it belongs to this geometry",
        spherecal_identify::evaluate::millimetres(&model.tool.tcp_m),
        model.frame_names.1
    ));
    notes
}

/// Where a base frame is, in the frame of the measurements.
pub(crate) fn base_note(name: &str, base: &Pose) -> String {
    format!(
        "base frame {name} at {} mm, turned by the rotation vector ({:.6}, {:.6}, {:.6}) rad, in the frame of the measurements",
        spherecal_identify::evaluate::millimetres(&base.position.into()),
        base.rotation_vector().x,
        base.rotation_vector().y,
        base.rotation_vector().z
    )
}

/// The base frame of the files' geometry in the first frame of the measurements.
pub(crate) fn base_of_files(evaluation: &Evaluation) -> Pose {
    let (full, own) = (&evaluation.calibration.base, &evaluation.geometry.base);
    Pose {
        position: full.position + full.rotation * own.position,
        rotation: full.rotation * own.rotation,
    }
}

/// The effects that a bare table cannot hold, for the TOML.
fn effects_toml(results: &Results<'_>) -> String {
    let c = &results.evaluation.calibration;
    let list = |values: &[f64]| {
        let words: Vec<String> = values.iter().map(|v| format!("{v:?}")).collect();
        format!("[{}]", words.join(", "))
    };
    let pairs = |values: &[[f64; 2]]| {
        let words: Vec<String> = values.iter().map(|v| list(v)).collect();
        format!("[{}]", words.join(", "))
    };
    let mut out = String::from(
        "\n# The full model: its own table of links (the tables above are the best geometry alone), and what a table cannot\n\
         # hold. `docs/compensate.md` has the formula and two programs that correct joint commands with it.\n\
         [calibration]\n",
    );
    let links = |f: &dyn Fn(&MdhRow<f64>) -> f64| list(&c.robot.joints.iter().map(|j| f(&j.mdh)).collect::<Vec<f64>>());
    let _ = writeln!(out, "alpha_rad = {}", links(&|r| r.alpha));
    let _ = writeln!(out, "a_m = {}", links(&|r| r.a));
    let _ = writeln!(out, "theta_rad = {}", links(&|r| r.theta));
    let _ = writeln!(out, "d_m = {}", links(&|r| r.d));
    let _ = writeln!(out, "beta_rad = {}", links(&|r| r.beta));
    let _ = writeln!(out, "tcp_m = {}", list(&c.tool.tcp_m));
    let _ = writeln!(out, "method = \"{}\"", c.method);
    let _ = writeln!(out, "model = \"{}\"", c.model);
    let _ = writeln!(out, "may_be_used = {}", results.evaluation.verdict.may_be_used);
    let _ = writeln!(out, "compliance_rad_per_nm = {}", list(&c.compliance_rad_per_nm));
    let _ = writeln!(out, "bending_rad_per_nm = {}", pairs(&c.bending_rad_per_nm));
    let _ = writeln!(out, "tilt_rad_per_nm = {}", list(&c.tilt_rad_per_nm));
    let harmonics: Vec<String> = c.harmonics_rad.iter().map(|h| pairs(h)).collect();
    let _ = writeln!(out, "harmonics_rad = [{}]", harmonics.join(", "));
    out += &nominal_toml(results);
    out
}

/// The robot that a controller keeps, and the masses that load the joints.
fn nominal_toml(results: &Results<'_>) -> String {
    let calibration = &results.evaluation.calibration;
    let compensator = calibration.compensator(&results.nominal.robot, results.given_tcp_m);
    let joints = compensator.joints();
    let list = |f: &dyn Fn(&CompensatedJoint) -> String| {
        let words: Vec<String> = joints.iter().map(f).collect();
        format!("[{}]", words.join(", "))
    };
    let mut out = String::from(
        "\n# The nominal robot that a controller keeps, and the masses that load its joints (the last one holds the tool).\n\
         [calibration.nominal]\n",
    );
    for (name, value) in [
        ("alpha_rad", list(&|j| format!("{:?}", j.nominal.alpha))),
        ("a_m", list(&|j| format!("{:?}", j.nominal.a))),
        ("theta_rad", list(&|j| format!("{:?}", j.nominal.theta))),
        ("d_m", list(&|j| format!("{:?}", j.nominal.d))),
        ("beta_rad", list(&|j| format!("{:?}", j.nominal.beta))),
        ("tcp_m", format!("{:?}", compensator.nominal_tcp_m())),
        ("mass_kg", list(&|j| format!("{:?}", j.mass_kg))),
        ("com_m", list(&|j| format!("{:?}", j.com_m))),
    ] {
        let _ = writeln!(out, "{name} = {value}");
    }
    out
}
