//! spherecal: a robot calibrates itself by touching precision spheres.
//!
//! The program `spherecal` ([`cli`]), and all crates of the host under one name:
//!
//! ```text
//! plan ─▶ campaign ─▶ link ─▶ controller (firmware) ─▶ sim, or a real arm
//! report ◀─ identify ◀─ store ◀─ campaign
//! ```
//!
//! A crate depends only on those below it in this table:
//!
//! | crate | what it is for |
//! |---|---|
//! | [`job`] | the main job: configuration, prepare, measure, evaluate, write |
//! | [`services`] | web page, live view, gRPC |
//! | [`export`] | runs as tables and bags |
//! | [`results`] | the files of a calibration |
//! | [`report`] | the page, its charts |
//! | [`campaign`] | the external controller of the paper; telemetry |
//! | [`store`] | the database of calibrations |
//! | [`sim`] | the simulated cell; fault injection |
//! | [`link`] | the links to controller and drive |
//! | [`plan`] | selects spheres and poses |
//! | [`identify`] | calibration from plain data |
//! | [`bag`] | ROS 2 bags as tables of poses |
//! | [`explain`] | why a table does not fit a robot |
//! | [`model`] | robots, kinematics, measured data |

pub mod cli;
pub mod simulated;

pub use spherecal_bag as bag;
pub use spherecal_campaign as campaign;
pub use spherecal_explain as explain;
pub use spherecal_export as export;
pub use spherecal_identify as identify;
pub use spherecal_job as job;
pub use spherecal_link as link;
pub use spherecal_model as model;
pub use spherecal_plan as plan;
pub use spherecal_report as report;
pub use spherecal_results as results;
pub use spherecal_services as services;
pub use spherecal_sim as sim;
pub use spherecal_store as store;
