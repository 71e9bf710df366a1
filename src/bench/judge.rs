//! Whether errors of a scene are as small as its tolerance asks.
//!
//! At any instant t the error should be at most the tolerance times t, and no more than the sum of the estimates so far.
//! A scene whose motion amplifies whatever is done to it is marked: a change of every omega by a millionth moves a
//! vertex by more than 30 millionths of R omega t.

use super::{
    MeasureError,
    error::LEAST_ALLOWED,
    reference::{Accuracy, NoReference, Reference},
};
use crate::{Scene, World};

/// A scene and its error.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The scene.
    pub scene: Scene,
    /// The largest ratio of an error to what the tolerance allows until then [–].
    pub factor: f64,
    /// The largest error of a vertex [radii].
    pub error: f64,
    /// The sum of the estimates [radii].
    pub estimates: f64,
    /// Whether the error was above the sum of the estimates at some instant.
    pub is_underestimated: bool,
    /// Distance of the reference from one with ten times the tolerance and twice the step [radii].
    pub agreement: f64,
    /// Whether the motion amplifies any error. Examined only where the error is too large.
    pub amplifies: bool,
    /// Why there is no error to compare: the run ended early, or there is no reference.
    pub failure: Option<String>,
}

/// Runs a scene and compares every step with the reference.
///
/// # Errors
/// [`MeasureError::World`]
pub fn judge(scene: Scene) -> Result<Outcome, MeasureError> {
    let instants: Vec<f64> = (0..=scene.steps()).map(|step| step as f64 * scene.dt).collect();
    let mut outcome = Outcome {
        factor: 0.0,
        error: 0.0,
        estimates: 0.0,
        is_underestimated: false,
        agreement: 0.0,
        amplifies: false,
        failure: None,
        scene,
    };
    let solve = |scene: &Scene, accuracy| Reference::solve(scene, &instants, accuracy);
    let found = solve(&outcome.scene, Accuracy::TIGHTER)
        .and_then(|reference| Ok((solve(&outcome.scene, Accuracy::DEFAULT)?, reference)));
    let (usual, reference) = match found {
        Ok(found) => found,
        Err(error) => return Ok(Outcome { failure: Some(error.to_string()), ..outcome }),
    };
    let mut world = World::new(outcome.scene.clone())?;
    for (k, &t) in instants.iter().enumerate().skip(1) {
        let report = world.step();
        if let Some(failure) = &report.failure {
            outcome.failure = Some(failure.to_string());
            return Ok(outcome);
        }
        outcome.estimates += report.error;
        outcome.agreement = outcome.agreement.max(usual.difference(&reference, &outcome.scene, k));
        // what the two references do not agree on is no error
        let largest = world.bodies().enumerate().map(|(index, body)| reference.error(index, &body, k));
        let error = (largest.fold(0.0, f64::max) - outcome.agreement).max(0.0);
        outcome.error = outcome.error.max(error);
        outcome.factor = outcome.factor.max(error / f64::max(LEAST_ALLOWED, outcome.scene.tolerance * t));
        outcome.is_underestimated |= error > outcome.estimates.max(0.1 * LEAST_ALLOWED);
    }
    if outcome.factor > 1.0 || outcome.is_underestimated {
        outcome.amplifies = match amplifies(&outcome.scene, &reference, &instants) {
            Ok(amplifies) => amplifies,
            Err(error) => return Ok(Outcome { failure: Some(error.to_string()), ..outcome }),
        };
    }
    Ok(outcome)
}

/// Whether a change of every omega by a millionth moves a vertex by more than 30 millionths of R omega t at some
/// instant.
///
/// # Errors
/// The changed scene has no reference.
pub fn amplifies(scene: &Scene, reference: &Reference, instants: &[f64]) -> Result<bool, NoReference> {
    const CHANGE: f64 = 1e-6;
    const ORDINARY: f64 = 30.0;
    let mut changed = scene.clone();
    changed.bodies.iter_mut().for_each(|body| body.material.omega *= 1.0 + CHANGE);
    let other = Reference::solve(&changed, instants, Accuracy::DEFAULT)?;
    let omega = scene.bodies.iter().map(|body| body.material.omega).fold(0.0, f64::max);
    let is_far = |(k, &t): (usize, &f64)| reference.difference(&other, scene, k) > ORDINARY * CHANGE * omega * t;
    Ok(instants.iter().enumerate().skip(1).any(is_far))
}
