//! The Gragg–Bulirsch–Stoer method: one step of Gragg's modified midpoint rule, taken with 2, 4, 6 … divisions and
//! extrapolated to infinitely many (Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.9).
//! The order adapts to the step. No code is shared with the integrators that it is compared with.

/// Maximum number of midpoint solutions of a step: up to 20 divisions and order 20.
const COLUMNS: usize = 10;
/// A step that needs at most this many columns could have been longer.
const FEW_COLUMNS: usize = 5;

/// How well a step went.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The largest ratio of a coordinate's estimated error to its tolerance; above 1, the step was too long.
    pub error: f64,
    /// Number of midpoint solutions used.
    pub columns: usize,
}

impl Step {
    /// Whether the step meets its tolerance.
    pub fn is_accurate(&self) -> bool {
        self.error <= 1.0
    }

    /// Whether a longer step would also have met it.
    pub fn is_easy(&self) -> bool {
        self.is_accurate() && self.columns <= FEW_COLUMNS
    }
}

/// A step from `y` at time `t` [s].
#[derive(Clone, Copy)]
pub struct Start<'a> {
    /// Its time [s].
    pub t: f64,
    /// The state there.
    pub y: &'a [f64],
    /// f(t, y).
    pub slope: &'a [f64],
}

/// Scratch storage of the method, reused from step to step.
#[derive(Clone, Debug, Default)]
pub struct Extrapolation {
    /// The last row of the extrapolation tableau: `rows[j]` is free of error terms up to h^(2j).
    rows: Vec<Vec<f64>>,
    entry: Vec<f64>,
    before: Vec<f64>,
    now: Vec<f64>,
    stage: Vec<f64>,
    slope: Vec<f64>,
}

impl Extrapolation {
    /// Takes one step over `h` of y′ = f(t, y) and writes the state after it to `end`; `f` writes the slope, and
    /// `tolerance` is the permitted error of each coordinate.
    ///
    /// All but the last addition act on the increment y(t + h) − y(t), so rounding errors scale with the change, not
    /// with y.
    pub fn step(
        &mut self,
        f: &mut impl FnMut(f64, &[f64], &mut [f64]),
        start: Start<'_>,
        h: f64,
        tolerance: &[f64],
        end: &mut Vec<f64>,
    ) -> Step {
        let n = start.y.len();
        self.rows.resize(COLUMNS, Vec::new());
        let mut result = Step { error: f64::INFINITY, columns: 0 };
        for k in 0..COLUMNS {
            self.midpoint(f, start, h, divisions(k));
            let mut error = 0.0;
            for (j, former) in self.rows.iter_mut().take(k).enumerate() {
                let ratio = f64::from(divisions(k)) / f64::from(divisions(k - 1 - j));
                let weight = 1.0 / (ratio * ratio - 1.0);
                error = 0.0;
                for i in 0..n {
                    let change = (self.entry[i] - former[i]) * weight;
                    former[i] = self.entry[i];
                    self.entry[i] += change;
                    let share = change.abs() / tolerance[i];
                    // written so that NaN stays
                    error = if share <= error || error.is_nan() { error } else { share };
                }
            }
            self.rows[k].clone_from(&self.entry);
            result = Step { error: if k >= 2 { error } else { f64::INFINITY }, columns: k + 1 };
            if result.is_accurate() || error.is_nan() {
                break;
            }
        }
        end.clear();
        end.extend(start.y.iter().zip(&self.entry).map(|(y, change)| y + change));
        result
    }

    /// Writes y(t + h) − y(t) by Gragg's rule with `n` divisions to the entry; its error is a series in (h/n)².
    fn midpoint(&mut self, f: &mut impl FnMut(f64, &[f64], &mut [f64]), start: Start<'_>, h: f64, n: u32) {
        let Extrapolation { entry, before, now, stage, slope, .. } = self;
        let part = h / f64::from(n);
        before.clear();
        before.resize(start.y.len(), 0.0);
        now.clear();
        now.extend(start.slope.iter().map(|slope| part * slope));
        slope.resize(start.y.len(), 0.0);
        for m in 1..=n {
            stage.clear();
            stage.extend(start.y.iter().zip(&*now).map(|(y, now)| y + now));
            f(start.t + f64::from(m) * part, stage, slope);
            if m == n {
                break;
            }
            for i in 0..now.len() {
                before[i] += 2.0 * part * slope[i];
            }
            std::mem::swap(before, now);
        }
        entry.clear();
        entry.extend((0..now.len()).map(|i| 0.5 * (now[i] + before[i] + part * slope[i])));
    }
}

fn divisions(k: usize) -> u32 {
    2 * (k as u32 + 1)
}
