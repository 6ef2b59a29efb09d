//! The report: one self-contained HTML file, readable on screen (light and
//! dark) and on paper, without a request to any network.
//!
//! ```text
//!   study, or run ─▶ ReportInput (plain data, every section optional) ─▶ render ─▶ report.html
//! ```
//!
//! What is said comes first, in words; then the numbers, each with its figure.
//! Figures are SVG inside the page; their colours follow the page's theme.

mod charts;
mod from_holds;
mod from_run;
mod from_study;
mod input;
mod page;
mod space;
mod time_charts;

pub use from_holds::holds_report;
pub use from_run::run_report;
pub use from_study::study_report;
pub use input::{
    ContactTrace, Correlation, Curves, ErrorSeries, ErrorTable, Headline, Heap, ModelRow, ParameterRow, Prediction,
    ReportInput, ResidualPoint, SimpleTable, WorkspacePoint,
};
pub use page::render;

#[cfg(test)]
mod tests;
