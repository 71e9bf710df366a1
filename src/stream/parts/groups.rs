//! Plots of groups: volume, genus and number of bodies, under the name of the group's first body.

use std::collections::BTreeMap;

use rerun::{AnyValues, components::Text};

use super::Look;
use crate::{
    observe::{Schema, surface::Merged},
    stream::{
        chunks::Chunks,
        palette,
        series::{Interpolation, LineId, Series},
    },
};

/// Number of groups that were too expensive or impossible to unite.
pub const OVERLAPPING: &str = "/diagnostics/overlapping_groups";

/// The groups that have their own entities.
pub struct GroupPlots {
    /// Upper limit on their number.
    most: usize,
    known: BTreeMap<usize, GroupPlot>,
    /// Number of groups without a surface; `None` as long as there were none.
    overlapping: Option<LineId>,
}

struct GroupPlot {
    entity: String,
    volume: LineId,
    genus: LineId,
    count: LineId,
    /// The bodies that were last logged; empty while there is no such group.
    bodies: Vec<usize>,
}

impl GroupPlots {
    /// Starts without groups; at most `most` are added.
    pub fn new(most: usize) -> GroupPlots {
        GroupPlots { most, known: BTreeMap::new(), overlapping: None }
    }

    /// Logs what has changed.
    pub fn log(&mut self, look: Look<'_>, merged: &Merged, series: &mut Series, chunks: &mut Chunks) {
        let Look { schema, at, .. } = look;
        if merged.overlapping > 0 || self.overlapping.is_some() {
            let line = *self.overlapping.get_or_insert_with(|| {
                let name = "groups shown as overlapping meshes";
                Series::style(chunks, OVERLAPPING, name, palette::line(3), 1.5, Interpolation::Step);
                series.line(chunks, OVERLAPPING, Interpolation::Step)
            });
            series.log(chunks, line, merged.overlapping as f64, at);
        }
        for (first, plot) in &mut self.known {
            let is_there = merged.groups.iter().any(|group| group.bodies.first() == Some(first));
            if !is_there && !plot.bodies.is_empty() {
                for line in [plot.volume, plot.genus, plot.count] {
                    series.interrupt(chunks, line, at);
                }
                plot.bodies.clear();
            }
        }
        for group in &merged.groups {
            let Some(&first) = group.bodies.first() else { continue };
            if !self.known.contains_key(&first) {
                if self.known.len() >= self.most {
                    continue;
                }
                self.known.insert(first, GroupPlot::new(schema, first, self.known.len(), series, chunks));
            }
            let Some(plot) = self.known.get_mut(&first) else { continue };
            series.log(chunks, plot.volume, group.volume, at);
            series.log(chunks, plot.genus, group.genus as f64, at);
            series.log(chunks, plot.count, group.bodies.len() as f64, at);
            if plot.bodies != group.bodies {
                let names = group.bodies.iter().map(|&body| schema.bodies[body].name.as_str());
                chunks.log(&plot.entity, at, &AnyValues::default().with_component::<Text>("bodies", names));
                plot.bodies.clone_from(&group.bodies);
            }
        }
    }
}

impl GroupPlot {
    fn new(schema: &Schema, first: usize, number: usize, series: &mut Series, chunks: &mut Chunks) -> GroupPlot {
        let name = &schema.bodies[first].name;
        let entity = format!("/groups/{name}");
        let mut line = |of: &str, label: &str, shape| {
            let entity = format!("{entity}/{of}");
            Series::style(chunks, &entity, &format!("{label} of {name}'s group"), palette::line(number), 1.5, shape);
            series.line(chunks, &entity, shape)
        };
        GroupPlot {
            volume: line("volume", "volume [unit³]", Interpolation::Linear),
            genus: line("genus", "genus", Interpolation::Step),
            count: line("bodies", "bodies", Interpolation::Step),
            entity,
            bodies: Vec::new(),
        }
    }
}
