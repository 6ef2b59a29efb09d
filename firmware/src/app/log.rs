//! Log statements: `defmt` with the feature `defmt`, nothing without it.

/// Logs at level info.
macro_rules! log_info {
    ($($argument:tt)*) => {{
        #[cfg(feature = "defmt")]
        defmt::info!($($argument)*);
        #[cfg(not(feature = "defmt"))]
        $crate::app::log::unlogged!($($argument)*);
    }};
}

/// Logs at level warn.
macro_rules! log_warn {
    ($($argument:tt)*) => {{
        #[cfg(feature = "defmt")]
        defmt::warn!($($argument)*);
        #[cfg(not(feature = "defmt"))]
        $crate::app::log::unlogged!($($argument)*);
    }};
}

/// Logs at level error.
macro_rules! log_error {
    ($($argument:tt)*) => {{
        #[cfg(feature = "defmt")]
        defmt::error!($($argument)*);
        #[cfg(not(feature = "defmt"))]
        $crate::app::log::unlogged!($($argument)*);
    }};
}

/// Evaluates the arguments and discards them.
#[cfg(not(feature = "defmt"))]
macro_rules! unlogged {
    ($text:literal $(, $argument:expr)* $(,)?) => {
        let _ = ($(&$argument,)*);
    };
}
#[cfg(not(feature = "defmt"))]
pub(crate) use unlogged;
