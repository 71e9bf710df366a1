//! The two solvers: of scenes whose bodies are all on paths, and of coupled scenes.

use pulp::Arch;

use super::{
    coupled::Coupled,
    prescribed::Prescribed,
    report::{EditError, Failure, Overworked, StepReport, Toil},
    span::Span,
    work::{Stop, Work},
};
use crate::scene::{Push, Scene};

/// The state of all bodies and pairs, by what solves for it. One solver for all scenes would make bodies on
/// paths ten times slower.
#[derive(Clone)]
pub(super) enum Solver {
    /// All bodies are on paths: none depends on how another one moves.
    Prescribed(Box<Prescribed>),
    /// Free bodies, planes, or cores with a width: bodies are stepped together.
    Coupled(Box<Coupled>),
}

/// What a solver reads besides its own state.
#[derive(Clone, Copy)]
pub(super) struct Setting<'a> {
    pub scene: &'a Scene,
    /// Number of steps taken.
    pub step: u64,
    /// The instruction set of the kernels.
    pub arch: Arch,
    /// Whether the step in progress covers a part of Δt only, because an edit divides it.
    pub is_partial: bool,
}

impl Setting<'_> {
    /// Simulated time [s].
    pub fn time(&self) -> f64 {
        self.step as f64 * self.scene.dt
    }
}

/// A step that is being taken.
pub(super) struct Step<'a> {
    pub setting: Setting<'a>,
    /// The interval of time that it covers.
    pub span: Span,
    pub work: &'a mut Work,
    pub report: &'a mut StepReport,
}

impl Step<'_> {
    /// The bodies on which a push acts in the step, or begins to before `end` [s].
    pub fn pushed_before(&self, end: f64) -> impl Iterator<Item = u32> + use<'_> {
        let start = self.span.start;
        let acts = move |push: &&Push| push.start < end && (push.start >= start || push.acts_at(start));
        self.setting.scene.pushes.iter().filter(acts).map(|push| push.body as u32)
    }

    /// Why the step is not completed.
    pub fn failure(&self, stop: Stop, toil: Toil) -> Failure {
        let step = self.report.step;
        match stop {
            Stop::Interrupted => Failure::Interrupted { step },
            Stop::Overworked => Overworked { step, time: self.span.start, toil }.into(),
        }
    }
}

/// What a changed scene takes over from another one.
pub(super) struct Takeover<'a> {
    /// The other scene.
    pub scene: &'a Scene,
    /// The former index of each body that keeps its state.
    pub kept: &'a [Option<usize>],
    /// The time of the state [s].
    pub time: f64,
    /// Limit on the pairs of nearby bodies.
    pub max_pairs: u64,
}

impl Takeover<'_> {
    /// The index of each former body; `None` if it is gone, or does not keep its state.
    pub fn now_at(&self, count: usize) -> Vec<Option<usize>> {
        let mut now_at = vec![None; count];
        for (index, kept) in self.kept.iter().enumerate() {
            if let Some(old) = *kept {
                now_at[old] = Some(index);
            }
        }
        now_at
    }
}

impl Solver {
    /// Takes over the state of the solver of another scene. Pairs that a threshold has passed change phase, which is
    /// reported. False if there are too many pairs of nearby bodies.
    ///
    /// # Errors
    /// The other solver is of the other kind.
    pub fn resume(
        &mut self,
        setting: Setting<'_>,
        before: &Solver,
        takeover: &Takeover<'_>,
        report: &mut StepReport,
    ) -> Result<bool, EditError> {
        match (self, before) {
            (Solver::Prescribed(now), Solver::Prescribed(before)) => Ok(now.resume(setting, before, takeover, report)),
            (Solver::Coupled(now), Solver::Coupled(before)) => Ok(now.resume(setting.scene, before, takeover, report)),
            _ => Err(EditError::Solver),
        }
    }

    /// The bodies of a scene, undeformed and without pairs, to [take over](Solver::resume) a state.
    pub fn undeformed(scene: &Scene) -> Solver {
        match scene.is_coupled() {
            true => Solver::Coupled(Box::new(Coupled::undeformed(scene))),
            false => Solver::Prescribed(Box::new(Prescribed::undeformed(scene))),
        }
    }

    /// The scene at t = 0; `None` if it has more than `max_pairs` pairs of nearby bodies.
    pub fn new(scene: &Scene, max_pairs: u64, work: &mut Work) -> Option<Solver> {
        Some(match scene.is_coupled() {
            true => Solver::Coupled(Box::new(Coupled::new(scene, max_pairs, work)?)),
            false => Solver::Prescribed(Box::new(Prescribed::new(scene, max_pairs, work)?)),
        })
    }

    /// Takes a step. Returns the first body whose state is invalid afterwards.
    ///
    /// # Errors
    /// The step could not be completed.
    pub fn step(&mut self, step: &mut Step<'_>) -> Result<Option<usize>, Failure> {
        match self {
            Solver::Prescribed(prescribed) => prescribed.step(step),
            Solver::Coupled(coupled) => coupled.step(step),
        }
    }

    /// The solver of bodies on paths, if it is that.
    pub fn prescribed(&self) -> Option<&Prescribed> {
        match self {
            Solver::Prescribed(prescribed) => Some(prescribed),
            Solver::Coupled(_) => None,
        }
    }

    /// The solver of coupled scenes, if it is that.
    pub fn coupled(&self) -> Option<&Coupled> {
        match self {
            Solver::Prescribed(_) => None,
            Solver::Coupled(coupled) => Some(coupled),
        }
    }

    /// A hash of the exact state.
    pub fn hash(&self) -> u64 {
        match self {
            Solver::Prescribed(prescribed) => prescribed.hash(),
            Solver::Coupled(coupled) => coupled.hash(),
        }
    }
}
