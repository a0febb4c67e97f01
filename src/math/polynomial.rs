//! Real roots of polynomials with real coefficients.

use nalgebra::DMatrix;

/// Real roots of `c[0] + c[1] x + … + c[n] xⁿ`, ascending, each polished by Newton's method.
///
/// Eigenvalues of the companion matrix; a root counts as real when its imaginary part is within 1e-6 of its size, which
/// keeps double roots that rounding has split into a complex pair. Leading coefficients that vanish lower the degree.
pub fn real_roots(coefficients: &[f64]) -> Vec<f64> {
    if coefficients.iter().any(|c| !c.is_finite()) {
        return Vec::new();
    }
    let largest = coefficients.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    let Some(degree) = coefficients.iter().rposition(|c| c.abs() > 1e-14 * largest) else { return Vec::new() };
    if degree == 0 {
        return Vec::new();
    }
    let lead = coefficients[degree];
    let mut companion = DMatrix::<f64>::zeros(degree, degree);
    for k in 0..degree {
        companion[(k, degree - 1)] = -coefficients[k] / lead;
        if k > 0 {
            companion[(k, k - 1)] = 1.0;
        }
    }
    let Some(schur) = companion.try_schur(f64::EPSILON, 400) else { return Vec::new() };
    let used = &coefficients[..=degree];
    let mut roots: Vec<f64> = schur
        .complex_eigenvalues()
        .iter()
        .filter(|z| z.im.abs() <= 1e-6 * (1.0 + z.re.abs()))
        .map(|z| polished(used, z.re))
        .collect();
    roots.sort_by(f64::total_cmp);
    roots
}

/// Value of a polynomial and its derivative (Horner).
fn value_and_slope(coefficients: &[f64], x: f64) -> (f64, f64) {
    coefficients.iter().rev().fold((0.0, 0.0), |(value, slope), c| (value * x + c, slope * x + value))
}

fn polished(coefficients: &[f64], start: f64) -> f64 {
    let mut x = start;
    for _ in 0..3 {
        let (value, slope) = value_and_slope(coefficients, x);
        let next = x - value / slope;
        if !next.is_finite() || value_and_slope(coefficients, next).0.abs() >= value.abs() {
            break;
        }
        x = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_come_back() {
        // (x - 1)(x + 2)(x - 3)(x² + 1)
        let found = real_roots(&[6.0, -5.0, 4.0, -4.0, -2.0, 1.0]);
        assert_eq!(found.len(), 3);
        for (a, b) in found.iter().zip([-2.0, 1.0, 3.0]) {
            assert!((a - b).abs() < 1e-10);
        }
        assert_eq!(real_roots(&[1.0, 0.0, 1.0]), Vec::<f64>::new());
        assert!((real_roots(&[-4.0, 2.0, 0.0])[0] - 2.0).abs() < 1e-14);
        assert!(real_roots(&[5.0]).is_empty() && real_roots(&[0.0, 0.0]).is_empty());
        assert!(real_roots(&[f64::NAN, 1.0]).is_empty());
    }
}
