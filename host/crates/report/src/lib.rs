//! The report: one self-contained HTML file for screen (light and dark) and paper. It makes no
//! network request.
//!
//! ```text
//!   study, or run ─▶ ReportInput (plain data, every section optional) ─▶ render ─▶ report.html
//! ```
//!
//! The conclusion comes first, in words; then the numbers, each with its figure. Figures are SVG
//! inside the page; their colours follow the page's theme.

pub mod calibration;
mod certificate;
mod charts;
mod correlation_map;
mod from_study;
pub mod headline;
mod input;
pub mod judged;
mod page;
mod parts;
mod space;
mod time_charts;

pub use certificate::{BudgetLine, COVERAGE, Certificate, Conformity, PositionError, Uncertainty, millimetres};
pub use charts::ChartError;
pub use from_study::study_report;
pub use input::{
    Correlation, Curves, ErrorSeries, ErrorTable, FileError, Headline, HistogramChart, ModelRow, ParameterRow,
    PredictedAccuracy, ReportInput, ResidualPoint, SimpleTable, WorkspacePoint,
};
pub use page::render;

#[cfg(test)]
mod certificate_tests;
#[cfg(test)]
mod figures_tests;
#[cfg(test)]
mod tests;
