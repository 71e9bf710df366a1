//! The Gragg–Bulirsch–Stoer method: one step of Gragg's modified midpoint rule, taken with 2, 4, 6 … divisions and
//! extrapolated to infinitely many (Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.9).
//! The order adapts to the step. No code is shared with the integrators that it is compared with.

/// Maximum number of midpoint solutions of a step: up to 20 divisions and order 20.
const COLUMNS: usize = 10;
/// A step that needs at most this many columns could have been longer.
const FEW_COLUMNS: usize = 5;

/// A right-hand side y′ = f(t, y) with `N` coordinates.
pub trait Slope<const N: usize> {
    /// f(t, y).
    fn at(&self, t: f64, y: &[f64; N]) -> [f64; N];
}

impl<const N: usize, F: Fn(f64, &[f64; N]) -> [f64; N]> Slope<N> for F {
    fn at(&self, t: f64, y: &[f64; N]) -> [f64; N] {
        self(t, y)
    }
}

/// The result of a step.
#[derive(Clone, Copy, Debug)]
pub struct Step<const N: usize> {
    /// y at the end of the step.
    pub end: [f64; N],
    /// The largest ratio of a coordinate's estimated error to its tolerance; above 1, the step was too long.
    pub error: f64,
    /// Number of midpoint solutions used.
    pub columns: usize,
}

impl<const N: usize> Step<N> {
    /// Whether the step meets its tolerance.
    pub fn is_accurate(&self) -> bool {
        self.error <= 1.0
    }

    /// Whether a longer step would also have met it.
    pub fn is_easy(&self) -> bool {
        self.is_accurate() && self.columns <= FEW_COLUMNS
    }
}

/// Takes one step from `(t, y)` over `h`; `slope` is f(t, y), and `tolerance` the permitted error of each coordinate.
///
/// All but the last addition act on the increment y(t + h) − y(t), so rounding errors scale with the change, not with
/// y.
pub fn step<const N: usize>(
    f: &impl Slope<N>,
    t: f64,
    y: &[f64; N],
    slope: &[f64; N],
    h: f64,
    tolerance: &[f64; N],
) -> Step<N> {
    // the last row of the extrapolation tableau: row[j] is free of error terms up to h^(2j)
    let mut row = [[0.0; N]; COLUMNS];
    let mut result = Step { end: *y, error: f64::INFINITY, columns: 0 };
    for k in 0..COLUMNS {
        let mut entry = midpoint(f, t, y, slope, h, divisions(k));
        let mut change = [0.0; N];
        for (j, former) in row.iter_mut().take(k).enumerate() {
            let ratio = f64::from(divisions(k)) / f64::from(divisions(k - 1 - j));
            let weight = 1.0 / (ratio * ratio - 1.0);
            let before = std::mem::replace(former, entry);
            for i in 0..N {
                change[i] = (entry[i] - before[i]) * weight;
                entry[i] += change[i];
            }
        }
        row[k] = entry;
        if k >= 2 {
            let errors = change.iter().zip(tolerance).map(|(change, tolerance)| change.abs() / tolerance);
            // not `f64::max`, which would discard NaN
            let error = errors.fold(0.0, |a: f64, b| if a.is_nan() || b <= a { a } else { b });
            result = Step { end: std::array::from_fn(|i| y[i] + entry[i]), error, columns: k + 1 };
            if result.is_accurate() {
                break;
            }
        }
    }
    result
}

fn divisions(k: usize) -> u32 {
    2 * (k as u32 + 1)
}

/// y(t + h) − y(t) by Gragg's rule with `n` divisions; its error is a series in (h/n)².
fn midpoint<const N: usize>(f: &impl Slope<N>, t: f64, y: &[f64; N], slope: &[f64; N], h: f64, n: u32) -> [f64; N] {
    let part = h / f64::from(n);
    let mut before = [0.0; N];
    let mut now: [f64; N] = std::array::from_fn(|i| part * slope[i]);
    for m in 1..n {
        let slope = f.at(t + f64::from(m) * part, &std::array::from_fn(|i| y[i] + now[i]));
        let next = std::array::from_fn(|i| before[i] + 2.0 * part * slope[i]);
        (before, now) = (now, next);
    }
    let slope = f.at(t + h, &std::array::from_fn(|i| y[i] + now[i]));
    std::array::from_fn(|i| 0.5 * (now[i] + before[i] + part * slope[i]))
}
