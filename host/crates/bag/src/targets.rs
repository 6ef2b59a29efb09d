//! First reading of a bag: where the tool was, and which topics there are.

use std::path::PathBuf;

use spherecal_model::excerpt;

use super::error::BagError;
use super::messages::{JOINT_STATE, JointStateMessage, MessageRefusal, ToolPlace, target};
use spherecal_budget::files::TARGETS;

use super::records::each_message;
use super::topics::{BagMessage, ChosenTopics, Topics, Wanted, bad_message, taken};

/// Most placements of the plate.
const MOST_PLACES: usize = 1000;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Where {
    /// A measured point, in m.
    Point([f64; 3]),
    /// At the centre of a sphere; the number of the placement in [`Targets::places`].
    Sphere { sphere: u32, place: usize },
}

/// Where the tool was, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TargetAt {
    pub(crate) time_ns: i64,
    pub(crate) at: Where,
}

/// What the first reading found.
#[derive(Debug)]
pub(crate) struct Targets {
    pub(crate) chosen: ChosenTopics,
    /// In the order of their times.
    pub(crate) all: Vec<TargetAt>,
    /// Names of the placements; the empty one where a contact names none.
    pub(crate) places: Vec<String>,
    pub(crate) frame: String,
    /// Whether times are those of the headers.
    pub(crate) by_header: bool,
    pub(crate) joint_states: u64,
    /// Files that end early, in words.
    pub(crate) early: Vec<String>,
}

struct Scan<'a> {
    named: &'a [String],
    transform: Option<&'a (String, String)>,
    topics: Topics,
    /// Time of the recorder, time of the header, place.
    found: Vec<(i64, Option<i64>, Where)>,
    places: Vec<String>,
    frame: Option<String>,
    /// Whether every joint state has the time in its header.
    joint_headers: bool,
}

impl Scan<'_> {
    fn place(&mut self, name: &str) -> Result<usize, MessageRefusal> {
        if let Some(k) = self.places.iter().position(|known| known == name) {
            return Ok(k);
        }
        if self.places.len() >= MOST_PLACES {
            return Err((
                format!("it is in placement {} of the plate", MOST_PLACES + 1),
                "one identification takes 200 placements: split the bag".to_owned(),
            ));
        }
        self.places.push(name.to_owned());
        Ok(self.places.len() - 1)
    }

    fn take(&mut self, message: &BagMessage<'_>) -> Result<(), MessageRefusal> {
        let topic = message.topic;
        // Other encodings are refused as a topic.
        if topic.encoding != "cdr" {
            return Ok(());
        }
        if topic.kind == JOINT_STATE {
            if self.named.is_empty() || self.named.contains(&topic.name) {
                self.joint_headers &= JointStateMessage::time(message.data)?.is_some();
            }
            return Ok(());
        }
        let Some(kind) = taken(topic, self.named) else {
            return Ok(());
        };
        if self.found.len() >= TARGETS {
            return Err((
                format!("there are more than {TARGETS} messages"),
                "record the points at a lower rate, or split the bag".to_owned(),
            ));
        }
        let Some((time_ns, place)) = target(kind, message.data, self.transform)? else {
            return Ok(());
        };
        let at = match place {
            ToolPlace::Sphere { sphere, place } => Where::Sphere {
                sphere,
                place: self.place(place)?,
            },
            ToolPlace::Point { frame, at } => {
                let known = self.frame.get_or_insert_with(|| frame.to_owned());
                if known != frame {
                    return Err((
                        format!(
                            "its frame is \"{}\", and that of the messages before is \"{}\"",
                            excerpt(frame),
                            excerpt(known)
                        ),
                        "give all points in one frame, that of the instrument".to_owned(),
                    ));
                }
                Where::Point(at)
            }
        };
        self.found.push((message.time_ns, time_ns, at));
        Ok(())
    }
}

/// Reads the targets of a bag.
/// Errors: topics that are missing or not clear, and messages that cannot be used.
pub(crate) fn targets(
    bag: &str,
    files: &[PathBuf],
    wanted: &Wanted,
    progress: &mut dyn FnMut(u64),
) -> Result<Targets, BagError> {
    let mut scan = Scan {
        named: &wanted.topics,
        transform: wanted.transform.as_ref(),
        topics: Topics::default(),
        found: Vec::new(),
        places: Vec::new(),
        frame: None,
        joint_headers: true,
    };
    let mut early = Vec::new();
    for path in files {
        let ended = each_message(path, progress, &mut |message| {
            let number = scan.topics.count(message.topic).ok_or_else(|| BagError::Topics {
                path: path.display().to_string(),
                what: "has more than 10000 topics".to_owned(),
                remedy: "record the joint states and targets alone".to_owned(),
            })?;
            let refused = |refusal| bad_message(path, message.topic, number, refusal);
            scan.take(message).map_err(refused)
        })?;
        early.extend(ended);
    }
    let chosen = scan.topics.choose(bag, &wanted.topics).map_err(|error| match error {
        // What is missing may be in the part that was lost.
        BagError::Topics { path, what, remedy } if !early.is_empty() => BagError::Topics {
            path,
            what: format!("{what}; {}", early.join("; ")),
            remedy,
        },
        error => error,
    })?;
    let by_header = scan.joint_headers && scan.found.iter().all(|(_, header, _)| header.is_some());
    let mut all: Vec<TargetAt> = scan
        .found
        .into_iter()
        .map(|(recorded, header, at)| TargetAt {
            time_ns: header.filter(|_| by_header).unwrap_or(recorded),
            at,
        })
        .collect();
    all.sort_by_key(|target| target.time_ns);
    Ok(Targets {
        joint_states: scan.topics.messages(&chosen.joints),
        chosen,
        all,
        places: scan.places,
        frame: scan.frame.unwrap_or_default(),
        by_header,
        early,
    })
}
