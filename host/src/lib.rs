//! spherecal: a robot calibrates itself by touching precision spheres.
//!
//! The program `spherecal` ([`cli`]), and the host's crates under one name:
//!
//! ```text
//! plan ─▶ campaign ─▶ link ─▶ controller (firmware) ─▶ sim, or a real arm
//! report ◀─ identify ◀─ store ◀─ campaign
//! ```
//!
//! Each crate is one room; a crate sees only those below it:
//!
//! | crate | what it is for |
//! |---|---|
//! | [`lab`] | experiments: worlds, the paper reproduced, faults, soak, stability |
//! | [`job`] | the main job: configuration, prepare, measure, evaluate, write |
//! | [`services`] | web page, live view, gRPC |
//! | [`report`] | the page, its charts, exports |
//! | [`campaign`] | the external controller of the paper; telemetry |
//! | [`store`] | the database of calibrations |
//! | [`sim`] | the simulated cell; fault injection |
//! | [`link`] | the links to controller and drive |
//! | [`plan`] | where to touch, and in which poses |
//! | [`identify`] | calibration from plain data |
//! | [`model`] | robots, kinematics, measured data |

pub mod cli;

pub use spherecal_campaign as campaign;
pub use spherecal_identify as identify;
pub use spherecal_job as job;
pub use spherecal_lab as lab;
pub use spherecal_link as link;
pub use spherecal_model as model;
pub use spherecal_plan as plan;
pub use spherecal_report as report;
pub use spherecal_services as services;
pub use spherecal_sim as sim;
pub use spherecal_store as store;
