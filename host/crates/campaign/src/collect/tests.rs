//! Collecting from a scripted arm.

use super::*;
use spherecal_model::robots;

/// Plays joint angles: 2 s each at 1 kHz, then fails or goes on.
struct Script {
    poses: Vec<[f64; 7]>,
    reading: usize,
    commanded: bool,
}

impl Script {
    fn new(poses: &[[f64; 7]]) -> Self {
        Self {
            poses: poses.to_vec(),
            reading: 0,
            commanded: false,
        }
    }
}

impl StateReader for Script {
    fn joints(&self) -> usize {
        7
    }

    fn has_torques(&self) -> bool {
        false
    }

    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError> {
        let pose = self
            .poses
            .get(self.reading / 2000)
            .ok_or_else(|| LinkError::device("the cable is out"))?;
        reading.time_s = self.reading as f64 * 1e-3;
        reading.q = pose.to_vec();
        reading.commanded = self.commanded.then(|| "mode Move".to_owned());
        self.reading += 1;
        Ok(())
    }
}

#[derive(Default)]
struct Notes {
    wanted: Vec<(u32, u32)>,
    refused: usize,
}

impl CollectView for Notes {
    fn wants(&mut self, place: u32, sphere: u32, _: &[ContactRow]) {
        self.wanted.push((place, sphere));
    }

    fn kept(&mut self, _: &StillPose, _: &[ContactRow]) {}

    fn refused(&mut self, _: u32, _: u32, distance_m: f64) {
        assert!(distance_m > ON_SPHERE_M);
        self.refused += 1;
    }

    fn ready(&mut self) -> bool {
        true
    }
}

const AT: [f64; 7] = [0.2, -0.3, 0.1, -2.0, 0.3, 1.8, 0.6];

/// `AT` with the last joint turned: the TCP of the panda's bare flange stays where it is.
fn turned(by: f64) -> [f64; 7] {
    let mut q = AT;
    q[6] += by;
    q
}

fn run(script: &mut Script, path: &std::path::Path, notes: &mut Notes) -> (Result<bool, CollectError>, usize) {
    let model = robots::load("panda").expect("built in");
    let mut tool = model.tool_in_table();
    tool.tcp_m = [0.0, 0.0, 0.1];
    let chain = Chain::unchecked(&model.robot, &tool);
    let request = CollectRequest {
        visits: Visits {
            spheres: vec![1, 2],
            places: 1,
            poses: 4,
        },
        rules: StillRules::default(),
        patience: Duration::from_mins(1),
    };
    let mut table = ContactFile::open(path, 7, false).expect("a table");
    let done = collect(script, &chain, &mut table, &request, notes, &AtomicBool::new(false));
    (done, table.contacts().len())
}

// Fails if a lost connection loses a contact, or the next command does not go on at the sphere that lacks poses.
#[test]
fn a_lost_connection_loses_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("contacts.csv");
    let mut notes = Notes::default();
    let mut script = Script::new(&[AT, turned(0.3), turned(0.6)]);
    let (done, kept) = run(&mut script, &path, &mut notes);
    assert!(matches!(done, Err(CollectError::Link { kept: 3, .. })), "{done:?}");
    assert_eq!(kept, 3);
    let mut script = Script::new(&[turned(0.9)]);
    let (done, kept) = run(&mut script, &path, &mut notes);
    assert!(matches!(done, Ok(true)), "{done:?}");
    assert_eq!(kept, 4);
    assert_eq!(notes.wanted, [(1, 1), (1, 2), (1, 2)]);
}

// Fails if a pose in the air counts as one on the sphere.
#[test]
fn a_pose_away_from_the_sphere_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut notes = Notes::default();
    let mut away = AT;
    away[0] += 0.5;
    let mut script = Script::new(&[AT, away, turned(0.3)]);
    let (_, kept) = run(&mut script, &folder.path().join("contacts.csv"), &mut notes);
    assert_eq!((kept, notes.refused), (2, 1));
}

// Fails if a commanded arm, or one that cannot be this robot, is recorded.
#[test]
fn a_commanded_arm_and_another_robot_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("contacts.csv");
    let mut script = Script::new(&[AT]);
    script.commanded = true;
    let (done, kept) = run(&mut script, &path, &mut Notes::default());
    assert!(matches!(done, Err(CollectError::Commanded { .. })) && kept == 0);
    let mut other = AT;
    other[3] = 1.0;
    let (done, kept) = run(&mut Script::new(&[other]), &path, &mut Notes::default());
    assert!(matches!(done, Err(CollectError::OtherRobot { joint: 4, .. })) && kept == 0);
}
