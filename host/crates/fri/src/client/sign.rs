//! Finds the sign of the measured torques at rest.

use crate::JOINTS;

/// The sign of the measured torques.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasuredSign {
    /// At rest the measured torque equals `+gravity(q)`: what holds the arm.
    Positive,
    /// It equals `-gravity(q)`.
    Negative,
}

/// The least gravity, as root of the sum of squares over the joints, that tells a sign, N m.
const LEAST_GRAVITY: f64 = 10.0;
/// How much better one sign must explain the measurement: the other one leaves at least twice its residual.
const CLEARLY: f64 = 2.0;

/// Compares torques measured at rest with the model's gravity in the same pose, both in N m.
///
/// `None`: cannot tell. Either gravity is too small in this pose (stretch the arm forwards), or neither sign explains the
/// measurement (check the load data and the model).
pub fn measured_sign(measured: &[f64; JOINTS], gravity: &[f64; JOINTS]) -> Option<MeasuredSign> {
    let norm = |values: [f64; JOINTS]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
    let with = |sign: f64| norm(std::array::from_fn(|j| measured[j] - sign * gravity[j]));
    let (positive, negative) = (with(1.0), with(-1.0));
    let size = norm(*gravity);
    if !(size >= LEAST_GRAVITY) || !(positive.min(negative) < size) {
        None
    } else if positive * CLEARLY < negative {
        Some(MeasuredSign::Positive)
    } else if negative * CLEARLY < positive {
        Some(MeasuredSign::Negative)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a sign is guessed where it cannot be told, or missed where it is plain.
    #[test]
    fn the_sign_is_told_only_where_it_is_plain() {
        let gravity = [0.0, 40.0, 2.0, -15.0, 0.5, 1.0, 0.0];
        let measured = |sign: f64, bias: f64| std::array::from_fn(|j| sign * gravity[j] + bias);
        assert_eq!(
            measured_sign(&measured(1.0, 1.0), &gravity),
            Some(MeasuredSign::Positive)
        );
        assert_eq!(
            measured_sign(&measured(-1.0, 1.0), &gravity),
            Some(MeasuredSign::Negative)
        );
        assert_eq!(measured_sign(&[0.0; 7], &gravity), None);
        assert_eq!(measured_sign(&measured(1.0, 0.0), &[0.0; 7]), None);
        assert_eq!(measured_sign(&measured(1.0, 100.0), &gravity), None);
        assert_eq!(measured_sign(&[f64::NAN; 7], &gravity), None);
    }
}
