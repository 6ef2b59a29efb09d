//! `spherecal identify` with several tips: chains of one robot that begin with the same joints, a table of each.
//!
//! All chains are fitted together by least squares. That gives the joints that they share; their motion is taken out of the
//! rows. Then each chain is identified behind them, as any arm is.

use std::path::Path;

use spherecal_explain::{ChainRows, Slides, observations};
use spherecal_identify::study::{Study, StudyRequest, StudyStep};
use spherecal_job::{CertificateSection, study_certificate};
use spherecal_model::input::{Labels, Table, TableFormat, read_csv};
use spherecal_model::robots::{self, RobotModel, Trunk};
use spherecal_model::write_file;
use spherecal_results::{SharedJoints, limbs_urdf, summary_text};

use super::bag::BagTables;
use super::exit::{CliError, Exit};
use super::identify::{IdentifyArgs, request, with_bags};
use super::out::{errln, outln};
use super::study::{StudyProgress, identified, refuse, write_study};
use super::table::{Joints, put_right};

/// Name of the robot's file in `--out`.
const URDF: &str = "calibrated.urdf";

/// One tip with its chain and its table.
struct Tip {
    name: String,
    /// The chain from the base.
    whole: RobotModel,
    request: StudyRequest,
    tables: BagTables,
    /// The table that was made of a bag.
    from_bag: Option<String>,
    /// The table as it was put right, with the columns of the whole chain.
    table: Table,
    places: Labels,
}

impl Tip {
    /// Reads a tip's chain and its table.
    fn read(
        args: &IdentifyArgs,
        whole: &RobotModel,
        spec: &str,
        data: &Path,
        tool: Option<&str>,
    ) -> Result<Self, CliError> {
        let mut view = StudyProgress::new();
        let mut request = request(args, spec, data, tool).map_err(refuse)?;
        if let Some(chain) = whole.chain_words() {
            errln!("spherecal: a chain is {chain}");
        }
        let tables = BagTables::read(&args.bag, &mut request, whole, &mut |p| {
            view.show(StudyStep::Reading(p));
        });
        view.finish();
        let mut tables = tables?;
        let from_bag = tables.data.clone();
        put_right(&args.table, &mut request, whole, &mut tables, Joints::Path)?;
        let path = whole.joint_path().map_err(CliError::input)?;
        let format = TableFormat {
            joints: path.columns.len(),
            label: request.holdout.clone(),
            ..TableFormat::default()
        };
        let mut places = Labels::default();
        let csv = tables.data.as_deref().unwrap_or_default();
        let table = read_csv(&data.display().to_string(), csv.as_bytes(), &format, &mut places);
        Ok(Self {
            name: whole.frame_names.1.clone(),
            table: table.map_err(CliError::input)?,
            whole: whole.clone(),
            request,
            tables,
            from_bag,
            places,
        })
    }

    fn rows(&self) -> Result<ChainRows, CliError> {
        let tool = self.request.tool_mm.map(|mm| mm.map(|x| x / 1e3));
        Ok(ChainRows {
            path: self.whole.joint_path().map_err(CliError::input)?,
            tool: tool.unwrap_or(self.whole.tool.tcp_m).into(),
            observations: observations(&self.table),
        })
    }

    /// Identifies the chain behind the trunk, whose motion is taken out of the rows.
    fn study(&mut self, limb: usize, file: &str, trunk: &Trunk, shared: &Slides) -> Result<Study, CliError> {
        self.request.robot = format!("{file}#{}:{}", trunk.end, self.name);
        let mut own = robots::load_path(&self.request.robot).map_err(|e| refuse(e.into()))?;
        // The tip tells the reports of one robot apart, if its name has room.
        if let Ok(name) = format!("{} {}", own.robot.name, self.name).as_str().try_into() {
            own.robot.name = name;
        }
        let path = self.whole.joint_path().map_err(CliError::input)?;
        if self.table.rows().any(|row| row.tau.is_some()) {
            let note =
                "torques are of all joints of the chain and not of those behind the shared ones: they are not used";
            self.tables.notes.push(note.to_owned());
        }
        self.table.with_joints(|columns| {
            let angles = path.table_angles(&path.positions(columns));
            let behind = angles.len().saturating_sub(own.robot.dof());
            let angles = angles.get(behind..).unwrap_or_default().to_vec();
            (angles, shared.rest(limb, columns))
        });
        if !trunk.joints.is_empty() {
            self.tables.notes.push(format!(
                "the joints that all tips share ({}) were fitted to the rows of all tips by least squares (to {:.3} mm), and \
                 their motion was taken out of the points: this result is of the joints behind {}, and loads are those with \
                 the shared joints at zero",
                trunk.joints.join(", "),
                shared.left_m * 1e3,
                trunk.end
            ));
        }
        let label = self
            .request
            .holdout
            .as_deref()
            .filter(|_| !self.table.labels.is_empty());
        self.tables.data = Some(self.table.to_csv(&self.places, label));
        let sources = with_bags(&self.request, own, &self.tables).map_err(refuse)?;
        identified(&self.request, sources, &self.tables.notes, StudyProgress::new())
    }
}

/// Whether the options name several tips, or tables of several.
pub(super) fn are_meant(args: &IdentifyArgs) -> bool {
    let ends = args.robot.as_deref().and_then(|robot| robot.rsplit_once('#'));
    args.data.len() > 1 || ends.is_some_and(|(_, ends)| ends.contains(','))
}

/// The file and the two ends of `FILE#BASE:TIP,TIP` or `FILE#TIP,TIP` as a chain for each tip.
fn chains(robot: &str, count: usize) -> Result<(String, Vec<String>), CliError> {
    let (file, ends) = robot.rsplit_once('#').unwrap_or((robot, ""));
    let (base, tips) = ends.rsplit_once(':').unwrap_or(("", ends));
    let tips: Vec<&str> = tips.split(',').map(str::trim).filter(|tip| !tip.is_empty()).collect();
    if tips.len() != count {
        return Err(CliError::input(format!(
            "--robot: the tips are {} and the tables of --data {count}: write FILE.urdf#BASE:TIP,TIP with a tip for each table",
            tips.len()
        )));
    }
    let chain = |tip: &&str| format!("{file}#{base}:{tip}");
    Ok((file.to_owned(), tips.iter().map(chain).collect()))
}

fn of_one_chain(args: &IdentifyArgs) -> Option<&'static str> {
    let given = [
        ("--validate", args.validate.is_some()),
        ("--anonymise", args.anonymise.is_some()),
        ("--joint-columns", !args.joint_columns.is_empty()),
        ("--plate", args.plate.is_some()),
        ("--work-mm", args.work_mm.is_some()),
        ("--explain", args.explain),
        ("--json", args.json),
    ];
    given.iter().find(|option| option.1).map(|option| option.0)
}

/// Identifies a robot with several tips.
/// Errors: as for one, and tips that have no base in common or whose tables do not fit together.
pub(super) fn run(args: &IdentifyArgs) -> Result<Exit, CliError> {
    let robot = args.robot.as_deref().unwrap_or_default();
    // Refused before the work, not after it.
    let stated = match &args.certificate {
        Some(path) => CertificateSection::read(path).map_err(CliError::input)?,
        None => CertificateSection::default(),
    };
    if let Some(option) = of_one_chain(args) {
        return Err(CliError::input(format!(
            "{option}: is for one table; rows that judge a result have set = validate in the tables, and each tip has a \
             summary.json of its own"
        )));
    }
    let count = args.data.len();
    if args.tool_mm.len() > 1 && args.tool_mm.len() != count {
        return Err(CliError::input(format!(
            "--tool-mm: is given {} times for {count} tables: give one for all, or one for each",
            args.tool_mm.len()
        )));
    }
    if args.out.join("summary.json").exists() {
        return Err(CliError::input(format!(
            "--out: {} holds the result of one chain: give another folder",
            args.out.display()
        )));
    }
    let (file, specs) = chains(robot, count)?;
    let models = specs.iter().map(|spec| robots::load_path(spec));
    let models = models.collect::<Result<Vec<_>, _>>().map_err(|e| refuse(e.into()))?;
    let trunk = Trunk::of(&models).map_err(|e| refuse(e.into()))?;
    let mut tips = Vec::with_capacity(count);
    for (k, ((spec, whole), data)) in specs.iter().zip(&models).zip(&args.data).enumerate() {
        let tool = args.tool_mm.get(k).or(args.tool_mm.first());
        tips.push(Tip::read(args, whole, spec, data, tool.map(String::as_str))?);
    }
    let rows = tips.iter().map(Tip::rows).collect::<Result<Vec<_>, _>>()?;
    let shared = Slides::fit(&rows, trunk.joints.len()).map_err(CliError::input)?;
    let mut studies = Vec::with_capacity(count);
    for (k, tip) in tips.iter_mut().enumerate() {
        studies.push(tip.study(k, &file, &trunk, &shared)?);
    }
    let urdf = models.first().and_then(|whole| {
        let shared = SharedJoints {
            names: trunk.joints.clone(),
            origins: shared.trunk(),
            base: shared.base(),
            end: shared.trunk_end(),
            left_m: shared.left_m,
        };
        limbs_urdf(whole, &shared, &studies)
    });
    write(args, &stated, &tips, &studies, urdf.as_deref())
}

/// Writes the files of all tips, and says what they are.
fn write(
    args: &IdentifyArgs,
    stated: &CertificateSection,
    tips: &[Tip],
    studies: &[Study],
    urdf: Option<&str>,
) -> Result<Exit, CliError> {
    let put = |folder: &Path| -> Result<(), CliError> {
        let path = folder.join(URDF);
        let done = match urdf {
            Some(text) => write_file(&path, text),
            // One of an earlier run would be taken for this result.
            None => match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
                _ => Ok(()),
            },
        };
        done.map_err(|error| CliError::job(format!("{}: {error}", path.display())))
    };
    for (tip, study) in tips.iter().zip(studies) {
        let folder = args.out.join(
            tip.name
                .replace(|c: char| !(c.is_alphanumeric() || "-_.".contains(c)), "_"),
        );
        let certificate = study_certificate(study, stated);
        let paths = write_study(study, &folder, &certificate, tip.from_bag.as_deref())?;
        put(&folder)?;
        outln!("{}\n{}", tip.name, summary_text(study));
        for path in paths.iter().filter(|path| path.exists()) {
            outln!("  {}", path.display());
        }
    }
    put(&args.out)?;
    match urdf {
        Some(_) => outln!("the whole robot\n  {}", args.out.join(URDF).display()),
        None => outln!("no {URDF}: the geometry of no tip would be better than the nominal one"),
    }
    let used = studies.iter().all(|study| study.evaluation.verdict.may_be_used);
    Ok(if used { Exit::Done } else { Exit::NotTrusted })
}
