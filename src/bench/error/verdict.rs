//! Conclusions from the measurements of a scene.

use super::{Measurement, Report, Scheme};
use crate::{scene::Integrator, text::significant};

/// The run time that a scheme needs to stay within an error.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    /// The integrator.
    pub integrator: Integrator,
    /// See [`Scheme::family`].
    pub family: &'static str,
    /// Run time [s].
    pub seconds: f64,
}

impl Report {
    /// The integrators that reach an error of at most `target` [radii], fastest first, each with its fastest setting.
    ///
    /// Run times are interpolated between the measurements on a family's Pareto front, linearly in the logarithms, and
    /// never extrapolated.
    pub fn cheapest(&self, target: f64) -> Vec<Cost> {
        let families = self.measurements.chunk_by(|a, b| a.scheme.family() == b.scheme.family());
        let cost = |measurements: &[Measurement]| {
            let scheme = measurements.first()?.scheme;
            let seconds = self.seconds_for(measurements, target)?;
            Some(Cost { integrator: scheme.integrator(), family: scheme.family(), seconds })
        };
        let mut costs: Vec<Cost> = families.filter_map(cost).collect();
        costs.sort_by(|x, y| x.seconds.total_cmp(&y.seconds));
        let mut seen = vec![];
        costs.retain(|cost| {
            let is_first = !seen.contains(&cost.integrator);
            seen.push(cost.integrator);
            is_first
        });
        costs
    }

    fn seconds_for(&self, measurements: &[Measurement], target: f64) -> Option<f64> {
        let front = self.front(measurements);
        let reached = front.iter().position(|&(_, error)| error <= target)?;
        let (seconds, error) = front[reached];
        let Some(&(seconds_before, error_before)) = reached.checked_sub(1).and_then(|k| front.get(k)) else {
            return Some(seconds);
        };
        let share = (error_before / target).ln() / (error_before / error).ln();
        Some(seconds_before * (seconds / seconds_before).powf(share))
    }

    /// The Pareto front as `(run time [s], error [radii])`, sorted by time.
    fn front(&self, measurements: &[Measurement]) -> Vec<(f64, f64)> {
        let point = |it: &Measurement| it.error.map(|error| (it.seconds, error.max(self.resolution())));
        let mut points: Vec<_> = measurements.iter().filter_map(point).collect();
        points.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.total_cmp(&y.1)));
        let mut best = f64::INFINITY;
        points.retain(|&(_, error)| {
            let is_better = error < best;
            best = f64::min(best, error);
            is_better
        });
        points
    }

    /// A scheme's measurement at the scene's own step size.
    fn at_own_step(&self, scheme: Scheme) -> Option<&Measurement> {
        self.measurements.iter().find(|measurement| self.is_at_own_step(measurement) && measurement.scheme == scheme)
    }

    /// The verdict in a few lines of text.
    pub fn verdict(&self) -> Vec<String> {
        let mut lines = vec!["fastest for an error of at most".to_owned()];
        for digits in 2..=8 {
            let ms = |seconds: f64| significant(1e3 * seconds);
            let line = match self.cheapest(10f64.powi(-digits)).as_slice() {
                [] => "none".to_owned(),
                [only] => format!("{}, {} ms; no other integrator reaches it", only.family, ms(only.seconds)),
                [first, second, ..] => format!(
                    "{}, {} ms; then {}, {} ms, {} times as long",
                    first.family,
                    ms(first.seconds),
                    second.family,
                    ms(second.seconds),
                    significant(second.seconds / first.seconds)
                ),
            };
            lines.push(format!("  1e-{digits}  {line}"));
        }

        let fixed = |integrator| self.at_own_step(Scheme::Fixed(integrator));
        let own = self.measurements.iter().find(|it| match it.scheme {
            Scheme::Controlled { tolerance } => (tolerance / self.tolerance - 1.0).abs() < 1e-9,
            Scheme::Fixed(_) => false,
        });
        let exponential =
            [(fixed(Integrator::Exponential), "exponential, fixed step"), (own, "exponential, the scene's tolerance")];
        if exponential.iter().any(|(measurement, _)| measurement.is_some()) {
            lines.push(format!("at the scene's step of {:.6} s", self.dt));
        }
        for (measurement, name) in exponential {
            let Some(measurement) = measurement else { continue };
            let against = [Integrator::Rk4, Integrator::Thesis].map(|other| {
                let other = fixed(other)?;
                Some(format!("{}: {}", other.scheme.family(), self.compared(measurement, other)))
            });
            let against: Vec<String> = against.into_iter().flatten().collect();
            if !against.is_empty() {
                lines.push(format!("  {name}, against {}", against.join("; against ")));
            }
        }
        lines.extend(self.control_verdict());
        lines.extend(self.thesis_verdict());
        lines
    }

    /// The errors that the tolerances allow over the whole run, and the actual errors [radii], of runs with error
    /// control one of whose two errors the reference resolves.
    pub(super) fn allowed_and_actual(&self) -> Vec<(f64, f64)> {
        let of = |it: &Measurement| match it.scheme {
            Scheme::Controlled { tolerance } => Some((tolerance * self.duration, it.error?)),
            Scheme::Fixed(_) => None,
        };
        self.measurements
            .iter()
            .filter_map(of)
            .filter(|(allowed, actual)| allowed.max(*actual) > self.resolution())
            .collect()
    }

    /// A sentence that compares the actual error with the requested one.
    fn control_verdict(&self) -> Option<String> {
        let shares: Vec<f64> =
            self.allowed_and_actual().into_iter().map(|(allowed, actual)| actual / allowed).collect();
        let within = shares.iter().filter(|share| (0.01..=1.0).contains(*share)).count();
        let (min, max) = (shares.iter().copied().reduce(f64::min)?, shares.iter().copied().reduce(f64::max)?);
        let mut sentence = format!(
            "error control: the error is {min:.0e} to {max:.0e} of what the tolerance allows, between 1e-2 and 1 of it at \
             {within} of {} tolerances",
            shares.len()
        );
        let missed: Vec<String> =
            self.missed().map(|(tolerance, share)| format!("{tolerance:.0e} ({share:.1} times)")).collect();
        if !missed.is_empty() {
            sentence += &format!("\n  missed at some instant: {}", missed.join(", "));
        }
        Some(sentence)
    }

    /// The tolerances that were missed, each with the largest ratio of an error to what it allows until then.
    pub fn missed(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.measurements.iter().filter_map(|it| match (it.scheme, it.share) {
            (Scheme::Controlled { tolerance }, Some(share)) if !(share <= 1.0) => Some((tolerance, share)),
            _ => None,
        })
    }

    /// A comparison such as "error ÷ 350, time × 1.4".
    fn compared(&self, this: &Measurement, other: &Measurement) -> String {
        let ratio = |of: f64| match of {
            ..1e-4 => format!("÷ {:.0e}", 1.0 / of),
            ..1.0 => format!("÷ {}", significant(1.0 / of)),
            ..1e4 => format!("× {}", significant(of)),
            _ => format!("× {of:.0e}"),
        };
        let error = match (this.error, other.error) {
            (Some(this), Some(other)) => ratio(this.max(self.resolution()) / other.max(self.resolution())),
            (None, Some(_)) => "out of bounds".to_owned(),
            (Some(_), None) => "within bounds, the other not".to_owned(),
            (None, None) => "out of bounds in both".to_owned(),
        };
        format!("error {error}, time {}", ratio(this.seconds / other.seconds))
    }

    /// A sentence on whether the scheme as printed in the thesis converges.
    fn thesis_verdict(&self) -> Option<String> {
        let (factor, share) = self.thesis_stagnation()?;
        Some(format!(
            "thesis, as printed, does not converge: a step {factor:.0} times smaller leaves {:.0} % of its error",
            100.0 * share
        ))
    }

    /// The ratio of the largest to the smallest step size of the scheme as printed, and the fraction of the error that
    /// remains at the smallest, if it is too large for the scheme to be convergent.
    pub(super) fn thesis_stagnation(&self) -> Option<(f64, f64)> {
        let of_thesis = || self.measurements.iter().filter(|it| it.scheme == Scheme::Fixed(Integrator::Thesis));
        let (largest, smallest) = (of_thesis().next()?, of_thesis().next_back()?);
        let share = smallest.error? / largest.error?;
        (share >= 0.5).then_some((largest.dt / smallest.dt, share))
    }
}
