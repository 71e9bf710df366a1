//! Plots of groups: volume, area and topology of the surface, and number of bodies. The first body of a group gives it
//! its name.

use std::collections::BTreeMap;

use super::{FrameView, pairs::has_named_pairs};
use crate::{
    analysis::surface::Merged,
    observe::{Schema, surface::Group},
    sdk::{AnyValues, components::Text},
    stream::{
        chunks::Chunks,
        contract::{BODIES, GROUP, GROUP_LINE, OVERLAPPING},
        palette,
        series::{Interpolation, LineId, Series},
    },
};

/// The groups that have their own entities.
pub struct GroupPlots {
    /// Upper limit on their number.
    max_groups: usize,
    known: BTreeMap<usize, GroupPlot>,
    /// Plot of the number of groups without a surface; `None` until there is one.
    overlapping: Option<LineId>,
}

struct GroupPlot {
    entity: String,
    /// Plots of the group, in the order of [`values`].
    lines: Vec<LineId>,
    /// The bodies that were last logged; empty while there is no such group.
    bodies: Vec<usize>,
}

/// The plots of a group: their entities, names with units, and shapes.
pub const LINES: [(&str, &str, Interpolation); 6] = [
    ("volume", "volume [unit³]", Interpolation::Linear),
    ("genus", "genus", Interpolation::Step),
    ("bodies", "bodies", Interpolation::Step),
    ("area", "area [unit²]", Interpolation::Linear),
    ("components", "components", Interpolation::Step),
    ("euler", "Euler characteristic χ", Interpolation::Step),
];
/// Number of these plots in a batched scene, to limit the number of entities.
const LINES_OF_MANY: usize = 3;

/// The values of the plots.
pub fn values(group: &Group) -> [f64; 6] {
    let Group { volume, area, components, euler, genus, bodies, .. } = group;
    [*volume, *genus as f64, bodies.len() as f64, *area, *components as f64, *euler as f64]
}

impl GroupPlots {
    /// Starts without groups; at most `max_groups` get plots.
    pub fn new(max_groups: usize) -> GroupPlots {
        GroupPlots { max_groups, known: BTreeMap::new(), overlapping: None }
    }

    /// Logs changed values.
    pub fn log(&mut self, view: FrameView<'_>, merged: &Merged, series: &mut Series, chunks: &mut Chunks) {
        let FrameView { schema, at, .. } = view;
        if merged.overlapping > 0 || self.overlapping.is_some() {
            let line = *self.overlapping.get_or_insert_with(|| {
                let name = "groups shown as overlapping meshes";
                Series::style(chunks, OVERLAPPING.path, name, palette::line(3), 1.5, Interpolation::Step);
                series.line(chunks, OVERLAPPING.path, Interpolation::Step)
            });
            series.log(chunks, line, merged.overlapping as f64, at);
        }
        for (first, plot) in &mut self.known {
            let is_there = merged.groups.iter().any(|group| group.bodies.first() == Some(first));
            if !is_there && !plot.bodies.is_empty() {
                for &line in &plot.lines {
                    series.interrupt(chunks, line, at);
                }
                plot.bodies.clear();
            }
        }
        for group in &merged.groups {
            let Some(&first) = group.bodies.first() else { continue };
            if !self.known.contains_key(&first) {
                if self.known.len() >= self.max_groups {
                    continue;
                }
                self.known.insert(first, GroupPlot::new(schema, first, self.known.len(), series, chunks));
            }
            let Some(plot) = self.known.get_mut(&first) else { continue };
            for (line, value) in plot.lines.iter().zip(values(group)) {
                series.log(chunks, *line, value, at);
            }
            if plot.bodies != group.bodies {
                let names = group.bodies.iter().map(|&body| schema.bodies[body].name.as_str());
                chunks.log(&plot.entity, at, &AnyValues::default().with_component::<Text>(BODIES.0, names));
                plot.bodies.clone_from(&group.bodies);
            }
        }
    }
}

impl GroupPlot {
    fn new(schema: &Schema, first: usize, number: usize, series: &mut Series, chunks: &mut Chunks) -> GroupPlot {
        let name = &schema.bodies[first].name;
        let entity = GROUP.of(&[name]);
        let lines = LINES.iter().take(if has_named_pairs(schema) { LINES.len() } else { LINES_OF_MANY });
        let lines = lines.enumerate().map(|(index, &(of, label, shape))| {
            let entity = GROUP_LINE.of(&[name, of]);
            let rgb = palette::line(number * LINES.len() + index);
            Series::style(chunks, &entity, &format!("{label} {name}"), rgb, 1.5, shape);
            series.line(chunks, &entity, shape)
        });
        let lines = lines.collect();
        GroupPlot { lines, entity, bodies: Vec::new() }
    }
}
