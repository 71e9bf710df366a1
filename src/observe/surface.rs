//! The surfaces of groups of bodies, and the findings about pairs of them.

use std::sync::atomic::AtomicBool;

use glam::DVec3;

use super::{event::PairEvent, frame::Frame, schema::Schema};

/// A group of bodies and its surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// Indices of its bodies, ascending; at least two.
    pub bodies: Vec<usize>,
    /// Positions of the vertices in the world [scene unit], `[vertex_count]`.
    pub positions: Vec<DVec3>,
    /// Outward unit normals of the vertices [–], `[vertex_count]`; empty if they are computed from the
    /// triangles.
    pub normals: Vec<DVec3>,
    /// Origin of each vertex, `[vertex_count]`.
    pub origins: Vec<VertexOrigin>,
    /// Vertices of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// The curves along which the surfaces of two bodies meet.
    pub seams: Vec<SeamLine>,
    /// Number of connected components of the surface.
    pub components: usize,
    /// Euler characteristic: vertices − edges + triangles.
    pub euler: i64,
    /// Number of handles of all components.
    pub genus: i64,
    /// Volume [scene unit³].
    pub volume: f64,
    /// Area [scene unit²].
    pub area: f64,
}

/// Origin of a vertex of a merged surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexOrigin {
    /// Its own body, and the body that meets it at the nearest seam; equal far from any seam.
    pub bodies: [u32; 2],
    /// Share of the second body in the colour of the vertex: ½ on the seam, 0 far from it.
    pub share: f32,
    /// Index of the vertex in its body; `None` for a vertex created where surfaces meet.
    pub vertex: Option<u32>,
}

/// A line along which the surfaces of two bodies meet.
#[derive(Clone, Debug, PartialEq)]
pub struct SeamLine {
    /// The two bodies, ascending.
    pub bodies: [usize; 2],
    /// Positions along the seam, before the surface is smoothed [scene unit]; the last one equals the first if the seam
    /// is closed.
    pub positions: Vec<DVec3>,
}

/// Geometric measures of a pair, independent of its phase.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairMeasures {
    /// Smallest distance between the surfaces; if they overlap, minus how deep a point of one lies inside the other at
    /// most [radii of the smaller body].
    pub gap: f64,
    /// Volume of the intersection [radius³ of the smaller body].
    pub overlap: f64,
    /// Volume of the intersection as a fraction of the smaller body's volume.
    pub share: f64,
    /// Radius of the circle with the area enclosed by the seam [radii of the smaller body]; 0 without a seam.
    pub neck: f64,
    /// Length of the seam [radii of the smaller body].
    pub perimeter: f64,
}

/// Surfaces of groups that are not the unions of their bodies. They must depend on the frame alone, so that they can be
/// computed in parallel with the simulation, and again in a replay.
pub trait Surfaces: Send + Sync {
    /// The surfaces of all groups of a frame, and the measures of some pairs. Results that cannot be computed are
    /// omitted, and so are all results once the interrupt flag is raised.
    fn merge(&self, schema: &Schema, frame: &Frame, pairs: &[[usize; 2]], interrupt: Option<&AtomicBool>) -> Surfaced;

    /// The measures of a single pair. Worth implementing if they can be computed without a surface.
    fn measure(
        &self,
        schema: &Schema,
        frame: &Frame,
        pair: [usize; 2],
        interrupt: Option<&AtomicBool>,
    ) -> Option<PairMeasures> {
        self.merge(schema, frame, &[pair], interrupt).pairs.first().copied().flatten()
    }
}

/// The surfaces of a frame, as defined by a simulation.
#[derive(Clone, Debug, Default)]
pub struct Surfaced {
    /// The surface of each group of at least two bodies, closed and oriented, in ascending order of their first bodies;
    /// groups are disjoint. `None` for a surface that could not be computed.
    pub groups: Vec<Option<Group>>,
    /// Measures of the pairs, in the order of the request; `None` if they could not be computed.
    pub pairs: Vec<Option<PairMeasures>>,
}

/// A geometric finding about a pair at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceEvent {
    /// What was found.
    pub what: Finding,
    /// Time of the event [s].
    pub time: f64,
    /// The first step whose state is affected by the event.
    pub step: u64,
    /// Index of the first body of the pair.
    pub a: usize,
    /// Index of the second body of the pair; a < b.
    pub b: usize,
    /// Centre distance over the sum of the radii at that time [–].
    pub q: f64,
}

/// A geometric finding about a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// The surfaces begin to touch.
    Touch,
    /// The surfaces part.
    Part,
    /// The phase changes; the fields describe the surfaces at that time.
    Phase {
        /// Kind of event: `merge`, `split`, …
        name: &'static str,
        /// Whether the surfaces touch at that time.
        is_touching: bool,
        /// Time at which they began to touch [s], if they touch and the time is known.
        touched: Option<f64>,
        /// The measures at that time, if they could be computed.
        measures: Option<PairMeasures>,
    },
}

impl Finding {
    /// The findings that are events of their own, each with when it happens.
    pub const KINDS: [(&str, &str); 2] = [
        ("touch", "The surfaces of a pair begin to touch; no phase changes."),
        ("part", "The surfaces of a pair part; no phase changes."),
    ];
}

impl SurfaceEvent {
    /// Kind of event in one word.
    pub fn name(&self) -> &'static str {
        match self.what {
            Finding::Touch => Finding::KINDS[0].0,
            Finding::Part => Finding::KINDS[1].0,
            Finding::Phase { name, .. } => name,
        }
    }

    /// Describes the event in words.
    pub fn describe(&self, schema: &Schema) -> String {
        let pair = schema.pair_name(self.a, self.b);
        match self.what {
            Finding::Touch | Finding::Part => {
                let name = self.name();
                format!("{name} {pair} at t = {:.7} s, q = {:.6}, step {}", self.time, self.q, self.step)
            }
            Finding::Phase { name, .. } => match self.findings() {
                Some(findings) => format!("{name} {pair}: {findings}"),
                None => format!("{name} {pair}: the surfaces could not be compared"),
            },
        }
    }

    /// Whether the surfaces begin to touch, or part: an event of its own, not a remark on a phase change.
    pub fn is_contact(&self) -> bool {
        matches!(self.what, Finding::Touch | Finding::Part)
    }

    /// Whether this is the remark on a phase change.
    pub fn is_on(&self, event: &PairEvent) -> bool {
        let is_same = (self.a, self.b, self.time) == (event.a, event.b, event.time);
        is_same && matches!(self.what, Finding::Phase { name, .. } if name == event.name)
    }

    /// Describes the surfaces at a phase change in words; `None` if there are no measures.
    pub fn findings(&self) -> Option<String> {
        let Finding::Phase { is_touching, touched, measures, .. } = self.what else { return None };
        let PairMeasures { gap, share, neck, .. } = measures?;
        // bodies whose paths jump overlap at once
        if !is_touching && gap > -0.5e-3 {
            return Some(format!("surfaces {:.3} R apart", gap.max(0.0)));
        }
        let touched = match touched {
            Some(time) => format!("surfaces touched {:.3} s before", self.time - time),
            None => "surfaces touch".to_owned(),
        };
        Some(format!("{touched}; overlap {:.1} %, neck {neck:.2} R", 100.0 * share))
    }
}
