//! Numbers on the command line.

use super::error::InputError;
use crate::excerpt;

/// Three finite numbers `X,Y,Z`, each at most `largest` either way; `option`
/// names them in a refusal.
///
/// # Errors
/// Anything else, with the remedy.
pub fn triple(option: &str, text: &str, largest: f64) -> Result<[f64; 3], InputError> {
    let refuse = |remedy: &str| InputError::Field {
        file: "command line".to_owned(),
        field: option.to_owned(),
        value: format!("\"{}\"", excerpt(text)),
        remedy: remedy.to_owned(),
    };
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, z] = words.as_slice() else {
        return Err(refuse("write three numbers separated by commas, such as 50,0,100"));
    };
    let mut out = [0.0; 3];
    for (slot, word) in out.iter_mut().zip([x, y, z]) {
        let value: f64 = word
            .parse()
            .map_err(|_| refuse("write three numbers separated by commas, such as 50,0,100"))?;
        if !value.is_finite() || value.abs() > largest {
            return Err(refuse(&format!(
                "each number is finite and at most {largest} either way"
            )));
        }
        *slot = value;
    }
    Ok(out)
}
