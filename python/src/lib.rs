//! The extension module `spherecal._native` of the Python package.
//!
//! Stands between Python and the host's crates: arrays in, plain results out. The classes that
//! users see are in `spherecal/*.py`; they check the shapes of arrays and name the results.
//!
//! ```text
//! numpy ─ spherecal/*.py ─ _native (robot · identification · job) ─▶ host crates
//! ```
//!
//! Without the feature `command` there is no `job`: plans, runs and the command need the whole host.
//!
//! Long work releases Python's interpreter lock. A panic becomes the exception
//! `spherecal.InternalError` ([`error::guarded`]).

mod arrays;
mod compensate;
mod error;
mod identification;
#[cfg(feature = "command")]
mod job;
mod robot;
mod slides;

use pyo3::prelude::*;

/// The module's functions and classes.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("BUILT_IN", spherecal_shared::robot::BUILT_IN.to_vec())?;
    module.add_class::<robot::NativeRobot>()?;
    module.add_class::<identification::NativeIdentification>()?;
    module.add_function(wrap_pyfunction!(identification::identify, module)?)?;
    #[cfg(feature = "command")]
    {
        module.add_function(wrap_pyfunction!(job::plan, module)?)?;
        module.add_function(wrap_pyfunction!(job::tables, module)?)?;
        module.add_function(wrap_pyfunction!(job::main, module)?)?;
    }
    Ok(())
}
