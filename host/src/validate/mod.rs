//! Validation: the table of errors on configurations that no model was fitted to (Table 5).
