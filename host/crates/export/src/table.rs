//! A table in memory: named columns of one type each.

/// The values of one column.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// Floating point; NaN where there is none.
    Real(Vec<f64>),
    /// Whole numbers.
    Whole(Vec<i64>),
    /// Text.
    Text(Vec<String>),
}

impl Column {
    fn len(&self) -> usize {
        match self {
            Self::Real(v) => v.len(),
            Self::Whole(v) => v.len(),
            Self::Text(v) => v.len(),
        }
    }

    /// One value in CSV form: the shortest digits that read back exactly.
    pub(super) fn cell(&self, row: usize) -> String {
        match self {
            Self::Real(v) => v.get(row).map(|x| format!("{x:?}")),
            Self::Whole(v) => v.get(row).map(ToString::to_string),
            Self::Text(v) => v.get(row).cloned(),
        }
        .unwrap_or_default()
    }
}

/// Named columns of the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportTable {
    /// Name, also of its file.
    pub name: &'static str,
    /// Columns in order.
    pub columns: Vec<(String, Column)>,
}

impl ExportTable {
    /// A table without columns.
    pub fn new(name: &'static str) -> Self {
        Self {
            name,
            columns: Vec::new(),
        }
    }

    /// Adds a column of floating-point numbers.
    pub fn real(&mut self, name: impl Into<String>, values: impl IntoIterator<Item = f64>) {
        self.columns
            .push((name.into(), Column::Real(values.into_iter().collect())));
    }

    /// Adds a column of whole numbers. A number that does not fit becomes the largest that does.
    pub fn whole<T: TryInto<i64>>(&mut self, name: impl Into<String>, values: impl IntoIterator<Item = T>) {
        let values = values.into_iter().map(|v| v.try_into().unwrap_or(i64::MAX)).collect();
        self.columns.push((name.into(), Column::Whole(values)));
    }

    /// Adds a column of text.
    pub fn text(&mut self, name: impl Into<String>, values: impl IntoIterator<Item = String>) {
        self.columns
            .push((name.into(), Column::Text(values.into_iter().collect())));
    }

    /// Adds three columns, `NAME_x_UNIT` and so on.
    pub fn vector<'a>(&mut self, name: &str, unit: &str, values: impl Iterator<Item = &'a [f64; 3]> + Clone) {
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            self.real(format!("{name}_{letter}_{unit}"), values.clone().map(|v| v[axis]));
        }
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.columns.iter().map(|(_, c)| c.len()).max().unwrap_or(0)
    }
}
