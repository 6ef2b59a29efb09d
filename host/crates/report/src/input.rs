//! The input of a report: plain data, with every section optional.

use spherecal_identify::ExpectedError;
use spherecal_model::ContactTrace;

/// A file of the result with the error that it has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FileError {
    /// Its name.
    pub name: String,
    /// What it holds, and for whom.
    pub holds: String,
    /// Expected error over the work region; `None` if the file was not written.
    pub expected_mm: Option<ExpectedError>,
}

/// The verdict in words.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Headline {
    /// Whether the result may be used.
    pub trusted: bool,
    /// One sentence: before, after, with which file, may it be used.
    pub sentence: String,
    /// Why not, or what to keep in mind.
    pub reasons: Vec<String>,
    /// What to do next.
    pub next: String,
    /// Files with their errors.
    pub files: Vec<FileError>,
    /// Key figures of a result without files: label, value with unit, remark.
    pub figures: Vec<(String, String, String)>,
}

/// One model in a table of errors, in mm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelRow {
    /// Model, such as `nominal`.
    pub name: String,
    /// Mean error.
    pub mean_mm: f64,
    /// Standard deviation of the errors.
    pub std_mm: f64,
    /// Smallest error.
    pub min_mm: f64,
    /// Largest error.
    pub max_mm: f64,
}

/// A table of errors by model (Table 5 of the paper).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorTable {
    /// What it shows.
    pub title: String,
    /// How it was made.
    pub caption: String,
    /// Models, in order.
    pub rows: Vec<ModelRow>,
}

/// The errors of one model, one per validation sample, in mm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorSeries {
    /// Model, such as `nominal`.
    pub name: String,
    /// Errors.
    pub errors_mm: Vec<f64>,
}

/// A place in the workspace with the errors there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkspacePoint {
    /// TCP, in m.
    pub at_m: [f64; 3],
    /// Error of the nominal model, in mm.
    pub nominal_mm: f64,
    /// Error of the calibrated model, in mm.
    pub calibrated_mm: f64,
}

/// A histogram of one quantity, such as the latency of the trigger.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HistogramChart {
    /// What is counted, for the axis, with its unit.
    pub what: String,
    /// What it is counted over, for the other axis.
    pub of: String,
    /// Words under the figure.
    pub caption: String,
    /// Values.
    pub values: Vec<f64>,
    /// Step of the values, where they are counted in steps: no bar is narrower; 0 if there is none.
    pub step: f64,
}

/// Curves over time, such as the drift while the arm holds still.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// What is drawn, for the axis, with its unit.
    pub what: String,
    /// Words under the figure.
    pub caption: String,
    /// Name, and points: time in s, value.
    pub curves: Vec<(String, Vec<(f64, f64)>)>,
    /// Half the width of a band about zero, in the same unit; 0 for none.
    pub band: f64,
}

/// One parameter (Table 6 of the paper, with its uncertainty).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParameterRow {
    /// Name.
    pub name: String,
    /// Unit as shown; values are in it.
    pub unit: String,
    /// Value before.
    pub nominal: f64,
    /// Value now.
    pub estimate: f64,
    /// Standard deviation now.
    pub sigma: f64,
    /// Standard deviation before the data; 0 if there is none.
    pub prior_sigma: f64,
    /// Estimated at all.
    pub free: bool,
    /// Determined by the data.
    pub identified: bool,
}

/// One sample's residual.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResidualPoint {
    /// Sphere, place or device that it belongs to.
    pub group: String,
    /// Distance from its target, in mm.
    pub distance_mm: f64,
    /// Named as an outlier.
    pub outlier: bool,
}

/// Correlations of estimated parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Correlation {
    /// Names, in order.
    pub names: Vec<String>,
    /// Row by row, from −1 to 1.
    pub values: Vec<Vec<f64>>,
}

/// The accuracy that the fit predicts of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PredictedAccuracy {
    /// Mean over the workspace (1 sigma), in mm.
    pub mean_mm: f64,
    /// Largest in the workspace (1 sigma), in mm.
    pub max_mm: f64,
    /// Predicted (1 sigma) and actual error of each validation sample, in mm.
    pub pairs_mm: Vec<(f64, f64)>,
    /// In which frame the actual errors are, as a sentence.
    pub frame: String,
    /// The same in a few words, for the axis, such as "base fitted to the points"; empty if there
    /// is nothing to say.
    pub axis: String,
}

/// Any small table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SimpleTable {
    /// What it shows.
    pub title: String,
    /// Words under the title.
    pub caption: String,
    /// Column headers. The first column is text, the others are set as numbers.
    pub columns: Vec<String>,
    /// Rows of cells.
    pub rows: Vec<Vec<String>>,
}

/// All data that a report can show. Empty sections are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportInput {
    /// What the report is about, such as `iiwa7`.
    pub title: String,
    /// One line under it.
    pub subtitle: String,
    /// The verdict.
    pub headline: Headline,
    /// What was compared with what, in sentences; may be empty.
    pub comparison: String,
    /// Tables of errors; the first is the main one.
    pub error_tables: Vec<ErrorTable>,
    /// Errors by model, for the histograms; `nominal` is compared with the others.
    pub errors: Vec<ErrorSeries>,
    /// In which frame these errors are, in a few words for the axis; empty if there is nothing to
    /// say.
    pub errors_axis: String,
    /// Errors over the workspace.
    pub workspace: Vec<WorkspacePoint>,
    /// Force traces of the contacts (Figure 5 of the paper).
    pub contacts: Vec<ContactTrace>,
    /// Force that declares contact, in N.
    pub contact_threshold_n: f64,
    /// Latency and overshoot of the trigger over all contacts.
    pub triggers: Vec<HistogramChart>,
    /// How still the arm held.
    pub stillness: Vec<Curves>,
    /// Tables to that.
    pub stillness_tables: Vec<SimpleTable>,
    /// Parameters.
    pub parameters: Vec<ParameterRow>,
    /// What the data could determine, in sentences.
    pub identifiability: Vec<String>,
    /// Residuals of the calibration, in the order in which they were recorded.
    pub residuals: Vec<ResidualPoint>,
    /// Outliers: which, and why.
    pub outliers: Vec<(String, String)>,
    /// Correlations.
    pub correlation: Option<Correlation>,
    /// Expected errors by region.
    pub regions: Option<SimpleTable>,
    /// Predicted accuracy.
    pub prediction: Option<PredictedAccuracy>,
    /// Goodness of fit, contacts, seating, triggers.
    pub fit_tables: Vec<SimpleTable>,
    /// Faults and link.
    pub health_tables: Vec<SimpleTable>,
    /// Remarks.
    pub notes: Vec<String>,
    /// Versions, seeds, hashes, what was configured: name and value.
    pub provenance: Vec<(String, String)>,
    /// The whole configuration, line by line, for the screen: paper has its hash.
    pub configuration: Vec<String>,
}
