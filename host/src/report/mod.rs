//! The report: HTML, plots, summary.
