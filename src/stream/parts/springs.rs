//! The springs of bodies that are made of them, coloured by strain.

use super::FrameView;
use crate::{
    observe::{BodyFrame, Schema},
    sdk::{self, LineStrips3D},
    stream::{
        chunks::{Chunks, TrackId},
        contract::SPRINGS,
        extract::Float3,
        palette::{self, color},
    },
};

/// Line width [points on the screen].
const LINE: f32 = 1.5;

/// The springs, with the last logged values.
pub struct Springs {
    /// Those of each body, in the order of the schema; `None` if the body has none.
    bodies: Vec<Option<Logged>>,
    next: Rows,
}

struct Logged {
    track: TrackId,
    last: Rows,
}

#[derive(Default, PartialEq)]
struct Rows {
    strips: Vec<[Float3; 2]>,
    colors: Vec<u32>,
}

impl Springs {
    /// Logs static data; `None` if no body has springs.
    pub fn new(schema: &Schema, chunks: &mut Chunks) -> Option<Springs> {
        if !schema.bodies.iter().any(|body| body.has_springs) {
            return None;
        }
        let mut logged = |name: &str| {
            let entity = SPRINGS.of(&[name]);
            let style = LineStrips3D::update_fields().with_radii([sdk::Radius::new_ui_points(LINE)]);
            chunks.log_static(&entity, &style);
            let components = [LineStrips3D::descriptor_strips(), LineStrips3D::descriptor_colors()];
            Logged { track: chunks.track(&entity, components), last: Rows::default() }
        };
        let bodies = schema.bodies.iter().map(|body| body.has_springs.then(|| logged(&body.name)));
        Some(Springs { bodies: bodies.collect(), next: Rows::default() })
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, chunks: &mut Chunks) {
        for (logged, now) in self.bodies.iter_mut().zip(&view.frame.bodies) {
            let Some(logged) = logged else { continue };
            self.next.set(now);
            if self.next != logged.last {
                std::mem::swap(&mut self.next, &mut logged.last);
                chunks.push(logged.track, view.at, &[&logged.last.strips, &logged.last.colors]);
            }
        }
    }
}

impl Rows {
    fn set(&mut self, now: &BodyFrame) {
        self.strips.clear();
        self.strips
            .extend(now.springs.iter().map(|spring| spring.ends.map(|end| (now.centre + end).as_vec3().to_array())));
        self.colors.clear();
        self.colors.extend(now.springs.iter().map(|spring| color(palette::strain(spring.strain)).to_u32()));
    }
}
