//! ROS 2 bags in place of tables of poses.

use std::path::Path;

use clap::Args;
use spherecal_bag::{BagError, Poses, Wanted, is_bag, read_bag};
use spherecal_identify::study::StudyRequest;
use spherecal_model::input::ReadingProgress;
use spherecal_model::robots::RobotModel;

use super::args::BadValue;
use super::exit::CliError;

/// Name of the table in `--out` that was made of a bag.
pub(super) const POSES: &str = "poses-of-bag.csv";

/// How a bag is read.
#[derive(Args, Clone, Debug)]
pub struct BagArgs {
    /// Topics that are taken of a bag: one of joint states, and one of points or contacts. Needed where several could be
    /// meant, and for geometry_msgs/PoseStamped, TransformStamped, PoseArray, nav_msgs/Odometry, tf2_msgs/TFMessage and std_msgs/Int8 to
    /// UInt64 (number of the sphere).
    #[arg(
        long,
        help_heading = "A bag",
        value_name = "A,B",
        value_delimiter = ',',
        requires = "data"
    )]
    pub topics: Vec<String>,
    /// The transform of a bag that is the target, by its frames, on a topic of tf2_msgs/TFMessage that --topics names.
    #[arg(long, help_heading = "A bag", value_name = "PARENT:CHILD", requires = "topics")]
    pub tf: Option<String>,
    /// Band in which every joint of a bag stays while the arm rests, in mrad.
    #[arg(long, help_heading = "A bag", value_name = "MRAD", default_value = "0.5", requires = "data", value_parser = band)]
    pub rest_mrad: f64,
    /// The efforts of a bag's joint states are measured torques in N m: use them. Some robots publish currents there.
    #[arg(long, help_heading = "A bag", requires = "data")]
    pub effort_nm: bool,
}

/// A band from 1 urad to 50 mrad.
fn band(text: &str) -> Result<f64, BadValue> {
    let remedy = BadValue("give a width in mrad from 0.001 to 50");
    match text.parse::<f64>() {
        Ok(mrad) if (1e-3..=50.0).contains(&mrad) => Ok(mrad),
        _ => Err(remedy),
    }
}

#[derive(Debug, Default)]
pub(super) struct BagTables {
    pub(super) data: Option<String>,
    pub(super) validate: Option<String>,
    /// How the poses were formed.
    pub(super) notes: Vec<String>,
}

fn refused(error: BagError) -> CliError {
    CliError::input(error)
}

impl BagTables {
    /// Reads the bags among the tables of a request. Where there is one, the request's joint columns are names of joints:
    /// they are taken from it.
    /// Errors: a bag that cannot be used.
    pub(super) fn read(
        args: &BagArgs,
        request: &mut StudyRequest,
        model: &RobotModel,
        progress: &mut dyn FnMut(ReadingProgress),
    ) -> Result<Self, CliError> {
        let bags = [Some(&request.data), request.validate.as_ref()].map(|path| path.is_some_and(|path| is_bag(path)));
        if bags == [false, false] {
            return Ok(Self::default());
        }
        if !request.joint_columns.is_empty() && request.validate.is_some() && bags != [true, true] {
            return Err(CliError::input(
                "--joint-columns: --data and --validate are a bag and a table: name the table's columns q1, q2, .. or give \
                 two bags",
            ));
        }
        let names = std::mem::take(&mut request.joint_columns);
        let wanted = wanted(args, names, model)?;
        let mut own = Self::default();
        let mut read = |path: &Path, what: &str| -> Result<String, CliError> {
            let poses: Poses = read_bag(path, &wanted, progress).map_err(refused)?;
            own.notes
                .extend(poses.notes.iter().map(|note| format!("{what}: {note}")));
            Ok(poses.to_csv())
        };
        let data = bags[0].then(|| read(&request.data, "--data")).transpose()?;
        let validate = request.validate.as_deref().filter(|_| bags[1]);
        let validate = validate.map(|path| read(path, "--validate")).transpose()?;
        (own.data, own.validate) = (data, validate);
        Ok(own)
    }
}

/// What is wanted of a bag for a robot whose joints have these names in it; the robot's own names where there are none.
fn wanted(args: &BagArgs, names: Vec<String>, model: &RobotModel) -> Result<Wanted, CliError> {
    // Exported telemetry has the names of the URDF that is made for a robot without one.
    let made = model.frame_tree(&model.tool_in_table()).joint_names().to_vec();
    // Joints that slide are recorded too, and those that follow others need not be.
    let path = model.joint_path().map_err(CliError::input)?;
    let plain = path.odd_joint().is_none();
    let columns = path.columns;
    let n = columns.len();
    let (joints, other_joints) = match (names.is_empty(), plain, model.joint_names.is_empty()) {
        (false, ..) => (names, Vec::new()),
        (true, false, _) => (columns, Vec::new()),
        (true, true, false) => (model.joint_names.clone(), made),
        (true, true, true) => (made, Vec::new()),
    };
    let mut sorted = joints.clone();
    sorted.sort();
    sorted.dedup();
    if joints.len() != n || sorted.len() != n {
        return Err(CliError::input(format!(
            "--joint-columns: has {} names of which {} differ: name each of the {n} joints once, base to flange",
            joints.len(),
            sorted.len()
        )));
    }
    let transform = args.tf.as_deref().map(|text| {
        text.split_once(':')
            .filter(|(parent, child)| !parent.is_empty() && !child.is_empty())
            .map(|(parent, child)| (parent.to_owned(), child.to_owned()))
            .ok_or_else(|| CliError::input("--tf: write PARENT:CHILD, such as camera_link:marker_3"))
    });
    Ok(Wanted {
        other_joints,
        transform: transform.transpose()?,
        topics: args.topics.clone(),
        rest_rad: args.rest_mrad * 1e-3,
        effort_nm: args.effort_nm,
        ..Wanted::new(joints)
    })
}
