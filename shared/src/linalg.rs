//! Small linear algebra of fixed size for the control path.
//!
//! All loops are bounded and run over arrays. Nothing allocates or panics, and
//! the order of the floating-point operations is the same on every target.
//! nalgebra holds the matrices. The factorisations are written here because the
//! control path needs them free of panics and in few instructions.

use nalgebra::{SMatrix, SVector};

use crate::scalar::Real;

/// Lower Cholesky factor of a symmetric positive definite matrix, `A = L Lᵀ`.
///
/// Stores the reciprocals of the diagonal, so that solving needs no division.
#[derive(Clone, Debug)]
pub struct Cholesky<T: Real, const N: usize> {
    lower: SMatrix<T, N, N>,
    inverse_diagonal: [T; N],
}

impl<T: Real, const N: usize> Cholesky<T, N> {
    /// Factorises `a`; reads the lower triangle only.
    ///
    /// `None` if a pivot is not positive or not a number: `a` is then not
    /// positive definite.
    #[inline]
    pub fn new(a: &SMatrix<T, N, N>) -> Option<Self> {
        Self::with_pivot_floor(a, T::zero())
            .filter(|(_, floored)| !floored)
            .map(|(f, _)| f)
    }

    /// Factorises `a` and raises each pivot below `floor` to `floor`.
    ///
    /// Returns the factor and whether a pivot was raised. Then
    /// `L Lᵀ = A + diag(δ)` with the smallest possible `δ >= 0`.
    /// `None` only if a pivot is not a number.
    #[inline]
    pub fn with_pivot_floor(a: &SMatrix<T, N, N>, floor: T) -> Option<(Self, bool)> {
        let mut lower = SMatrix::<T, N, N>::zeros();
        let mut inverse_diagonal = [T::zero(); N];
        let mut floored = false;
        for j in 0..N {
            let mut pivot = a[(j, j)];
            for k in 0..j {
                pivot -= lower[(j, k)] * lower[(j, k)];
            }
            // Written so that NaN fails both comparisons.
            if !(pivot > floor) {
                if !(pivot <= floor) {
                    return None;
                }
                floored = true;
                pivot = floor;
            }
            let diagonal = pivot.sqrt_of();
            let inverse = if diagonal > T::zero() {
                T::one() / diagonal
            } else {
                T::zero()
            };
            lower[(j, j)] = diagonal;
            inverse_diagonal[j] = inverse;
            for i in (j + 1)..N {
                let mut sum = a[(i, j)];
                for k in 0..j {
                    sum -= lower[(i, k)] * lower[(j, k)];
                }
                lower[(i, j)] = sum * inverse;
            }
        }
        Some((
            Self {
                lower,
                inverse_diagonal,
            },
            floored,
        ))
    }

    /// The lower triangular factor `L`.
    pub fn lower(&self) -> &SMatrix<T, N, N> {
        &self.lower
    }

    /// `L⁻¹ b`, by forward substitution.
    #[inline]
    pub fn solve_lower(&self, b: &SVector<T, N>) -> SVector<T, N> {
        let mut x = *b;
        for i in 0..N {
            let mut sum = x[i];
            for k in 0..i {
                sum -= self.lower[(i, k)] * x[k];
            }
            x[i] = sum * self.inverse_diagonal[i];
        }
        x
    }

    /// `L⁻ᵀ b`, by back substitution.
    #[inline]
    pub fn solve_upper(&self, b: &SVector<T, N>) -> SVector<T, N> {
        let mut x = *b;
        for i in (0..N).rev() {
            let mut sum = x[i];
            for k in (i + 1)..N {
                sum -= self.lower[(k, i)] * x[k];
            }
            x[i] = sum * self.inverse_diagonal[i];
        }
        x
    }

    /// `A x`, computed from the factor as `L (Lᵀ x)`.
    #[inline]
    pub fn multiply(&self, x: &SVector<T, N>) -> SVector<T, N> {
        let mut half = SVector::<T, N>::zeros();
        for i in 0..N {
            for k in i..N {
                half[i] += self.lower[(k, i)] * x[k];
            }
        }
        let mut product = SVector::<T, N>::zeros();
        for i in 0..N {
            for k in 0..=i {
                product[i] += self.lower[(i, k)] * half[k];
            }
        }
        product
    }

    /// `A⁻¹ b`.
    #[inline]
    pub fn solve(&self, b: &SVector<T, N>) -> SVector<T, N> {
        self.solve_upper(&self.solve_lower(b))
    }
}

/// One sweep of cyclic Jacobi rotations on the symmetric matrix `a`; applies them
/// to the basis `v`, too (`a ← Rᵀ a R`, `v ← v R`).
///
/// One sweep is enough when it starts from the eigenvectors of a nearby matrix.
/// From the identity a 6 x 6 matrix takes about six.
#[inline]
pub fn jacobi_sweep<T: Real, const N: usize>(a: &mut SMatrix<T, N, N>, v: &mut SMatrix<T, N, N>) {
    for p in 0..N {
        for q in (p + 1)..N {
            let off = a[(p, q)];
            if off == T::zero() {
                continue;
            }
            let (app, aqq) = (a[(p, p)], a[(q, q)]);
            let half_difference = crate::scalar::lit::<T>(0.5) * (aqq - app);
            // Tangent of the rotation angle that makes a[(p, q)] zero. Of the two
            // solutions it is the smaller, in a form that neither overflows nor
            // divides by zero.
            let root = (half_difference * half_difference + off * off).sqrt_of();
            let denominator = if half_difference < T::zero() {
                half_difference - root
            } else {
                half_difference + root
            };
            let t = if denominator == T::zero() {
                T::zero()
            } else {
                off / denominator
            };
            let c = T::one() / (T::one() + t * t).sqrt_of();
            let s = t * c;
            a[(p, p)] = app - t * off;
            a[(q, q)] = aqq + t * off;
            a[(p, q)] = T::zero();
            a[(q, p)] = T::zero();
            for k in 0..N {
                if k != p && k != q {
                    let (akp, akq) = (a[(k, p)], a[(k, q)]);
                    let (new_p, new_q) = (c * akp - s * akq, s * akp + c * akq);
                    a[(k, p)] = new_p;
                    a[(p, k)] = new_p;
                    a[(k, q)] = new_q;
                    a[(q, k)] = new_q;
                }
            }
            for k in 0..N {
                let (vkp, vkq) = (v[(k, p)], v[(k, q)]);
                v[(k, p)] = c * vkp - s * vkq;
                v[(k, q)] = s * vkp + c * vkq;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix4;
    use proptest::prelude::*;

    fn spd(values: [f64; 16]) -> Matrix4<f64> {
        let g = Matrix4::from_row_slice(&values);
        g * g.transpose() + Matrix4::identity() * 0.1
    }

    proptest! {
        // Fails if an element of the factor or one of the substitutions is wrong.
        #[test]
        fn cholesky_solves(values in prop::array::uniform16(-1.0f64..1.0), b in prop::array::uniform4(-1.0f64..1.0)) {
            let a = spd(values);
            let factor = Cholesky::new(&a).expect("positive definite by construction");
            let b = SVector::<f64, 4>::from(b);
            prop_assert!((a * factor.solve(&b) - b).norm() < 1e-10);
            prop_assert!((factor.lower() * factor.lower().transpose() - a).norm() < 1e-12);
        }

        // Fails if a rotation is not orthogonal or the result is not diagonal.
        #[test]
        fn jacobi_diagonalises(values in prop::array::uniform16(-1.0f64..1.0)) {
            let a = spd(values);
            let (mut d, mut v) = (a, Matrix4::identity());
            for _ in 0..8 {
                jacobi_sweep(&mut d, &mut v);
            }
            let diagonal = Matrix4::from_diagonal(&d.diagonal());
            prop_assert!((v * diagonal * v.transpose() - a).norm() < 1e-12);
            prop_assert!((v.transpose() * v - Matrix4::identity()).norm() < 1e-13);
        }
    }

    #[test]
    fn pivots_are_floored_not_refused() {
        let a: Matrix4<f64> = Matrix4::from_diagonal(&[1.0, 0.0, 4.0, 1e-9].into());
        assert!(Cholesky::new(&a).is_none());
        let (factor, floored) = Cholesky::with_pivot_floor(&a, 0.01).expect("finite");
        assert!(floored);
        assert!((factor.lower()[(1, 1)] - 0.1).abs() < 1e-15);
        assert!(Cholesky::with_pivot_floor(&(a * f64::NAN), 0.01).is_none());
    }
}
