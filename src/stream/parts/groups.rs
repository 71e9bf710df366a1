//! Plots of groups: volume, area and topology of the surface, and number of bodies; and of the volume of all surfaces. The
//! first body of a group gives it its name. With more than a few bodies, a ranking of the groups of an instant.

use std::collections::BTreeMap;

use super::{
    FrameView,
    pairs::has_named_pairs,
    ranking::{Mark, Ranking, Row, is_ranked},
};
use crate::{
    analysis::surface::Merged,
    colors::{GREY, SILVER},
    geometry::mesh::signed_volume_of,
    observe::{Schema, surface::Group},
    sdk::{AnyValues, components::Text},
    stream::{
        chunks::Chunks,
        contract::{BODIES, GROUP, GROUP_LINE, OVERLAPPING, RANKED_GROUPS, VOLUME},
        palette,
        series::{Interpolation, LineId, Series},
        settings::MAX_BODY_ENTITIES,
    },
    text::{counted, short},
};

/// The groups that have their own entities.
pub struct GroupPlots {
    /// Upper limit on their number.
    max_groups: usize,
    known: BTreeMap<usize, GroupPlot>,
    /// Plot of the number of groups without a surface; `None` until there is one.
    overlapping: Option<LineId>,
    /// Plots of the volume of all surfaces, in each variant of the scene; of at most so many bodies.
    of_surfaces: Vec<LineId>,
    /// The plot of the volumes of the bodies one by one, unless there are variants.
    of_bodies: Option<LineId>,
    /// The volumes of all surfaces and of the bodies one by one in this frame, if both are known [scene unit³].
    sums: Option<[f64; 2]>,
    /// The volume of the bodies one by one at first [scene unit³].
    first_of_bodies: Option<f64>,
    /// Where the volume of all surfaces has changed most so far: its ratio to that of the bodies one by one, and the
    /// ratio of that to the first.
    most_changed: Option<[f64; 2]>,
    /// Volume of each body at rest [scene unit³].
    at_rest: Vec<f64>,
    /// The volumes of the bodies one by one, if they are plotted [scene unit³]; reused.
    volumes: Vec<f64>,
    ranking: Option<Ranking>,
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

/// Whether the volumes of all surfaces and of the bodies are plotted.
pub fn has_volume(schema: &Schema) -> bool {
    !schema.variants.is_empty() || (2..=MAX_BODY_ENTITIES).contains(&schema.bodies.len())
}

impl GroupPlots {
    /// Starts without groups; at most `max_groups` get plots.
    pub fn new(schema: &Schema, max_groups: usize, series: &mut Series, chunks: &mut Chunks) -> GroupPlots {
        let has_variants = !schema.variants.is_empty();
        let has_volume = has_volume(schema);
        let mut line = |of: &str, label: &str, rgb, width| {
            let entity = VOLUME.of(&[of]);
            Series::style(chunks, &entity, label, rgb, width, Interpolation::Linear);
            series.line(chunks, &entity, Interpolation::Linear)
        };
        let of_surfaces = match has_volume && !has_variants {
            true => vec![line("surfaces", "all surfaces", palette::BODY_LINE, 2.5)],
            false => {
                let variants = schema.variants.iter().map(|variant| variant.name).enumerate();
                variants.map(|(number, name)| line(name, name, palette::line(number), 1.5)).collect()
            }
        };
        let of_bodies = (has_volume && !has_variants).then(|| line("bodies", "bodies one by one", GREY, 1.5));
        let bodies = if has_volume { schema.bodies.as_slice() } else { &[] };
        let at_rest = bodies.iter().map(|body| {
            let mesh = &body.mesh;
            body.radius.powi(3) * signed_volume_of(mesh.positions(), mesh.triangles())
        });
        let at_rest = at_rest.collect();
        let ranking = is_ranked(schema).then(|| Ranking::new(RANKED_GROUPS.path, chunks));
        let (known, volumes) = (BTreeMap::new(), Vec::new());
        GroupPlots {
            max_groups,
            known,
            overlapping: None,
            of_surfaces,
            of_bodies,
            sums: None,
            first_of_bodies: None,
            most_changed: None,
            at_rest,
            volumes,
            ranking,
        }
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
        self.log_volume(view, merged, series, chunks);
        self.log_ranking(view, merged, chunks);
        for (first, plot) in &mut self.known {
            let is_there = merged.groups.iter().any(|group| group.bodies.first() == Some(first));
            if !is_there && !plot.bodies.is_empty() {
                for &line in &plot.lines {
                    series.interrupt(chunks, line, at);
                }
                plot.bodies.clear();
                let none = AnyValues::default().with_component::<Text>(BODIES.0, [] as [&str; 0]);
                chunks.log(&plot.entity, at, &none);
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

impl GroupPlots {
    /// How much the volume changes at most, and by what, in words.
    pub fn changed_volume(&self) -> Option<String> {
        let [merging, deformation] = self.most_changed?;
        let [total, merging, deformation] = [merging * deformation, merging, deformation].map(percent);
        let is_changed = [&total, &merging, &deformation].into_iter().any(|change| change != "+0.0");
        is_changed
            .then(|| format!("largest change {total} %: overlaps and seams {merging} %, deformation {deformation} %"))
    }

    fn log_volume(&mut self, view: FrameView<'_>, merged: &Merged, series: &mut Series, chunks: &mut Chunks) {
        if self.of_surfaces.is_empty() {
            return;
        }
        let volumes =
            view.bodies().zip(&self.at_rest).map(|((body, now), at_rest)| match (now.is_absent, now.is_at_rest) {
                (true, _) => 0.0,
                (_, true) => *at_rest,
                _ => signed_volume_of(&now.positions, now.mesh_of(body).triangles()).abs(), // it may be inside out
            });
        self.volumes.clear();
        self.volumes.extend(volumes);
        let size = view.schema.variant_size();
        let mut sums = vec![0.0; self.of_surfaces.len()];
        for group in &merged.groups {
            sums[group.bodies[0] / size] += group.volume;
        }
        for (body, (volume, is_merged)) in self.volumes.iter().zip(&merged.is_merged).enumerate() {
            sums[body / size] += if *is_merged { 0.0 } else { *volume };
        }
        let sum: f64 = self.volumes.iter().sum();
        if let Some(line) = self.of_bodies {
            series.log(chunks, line, sum, view.at);
            self.sums = (merged.overlapping == 0).then_some([sums[0], sum]);
            let first = *self.first_of_bodies.get_or_insert(sum);
            let ratios = [sums[0] / sum, sum / first];
            let change = |[merging, deformation]: [f64; 2]| (merging * deformation - 1.0).abs();
            let is_most = self.most_changed.is_none_or(|most| change(ratios) > change(most));
            if merged.overlapping == 0 && change(ratios).is_finite() && is_most {
                self.most_changed = Some(ratios);
            }
        }
        for (&line, sum) in self.of_surfaces.iter().zip(sums) {
            match merged.overlapping {
                0 => series.log(chunks, line, sum, view.at),
                _ => series.interrupt(chunks, line, view.at),
            }
        }
    }
}

impl GroupPlots {
    /// Ranks the groups of an instant by their numbers of bodies and volumes, each beside the volume of its bodies one by one,
    /// if that is known.
    fn log_ranking(&self, view: FrameView<'_>, merged: &Merged, chunks: &mut Chunks) {
        let Some(ranking) = &self.ranking else { return };
        let mut groups: Vec<&Group> = merged.groups.iter().map(AsRef::as_ref).collect();
        groups
            .sort_by(|one, other| other.bodies.len().cmp(&one.bodies.len()).then(other.volume.total_cmp(&one.volume)));
        let apart = |group: &Group| match self.volumes.is_empty() {
            true => None,
            false => Some(group.bodies.iter().map(|&body| self.volumes[body]).sum::<f64>()),
        };
        // while there are groups, a body that is in none is one of its own
        let ranked = if groups.is_empty() || merged.overlapping > 0 { 0 } else { self.volumes.len() };
        let is_alone = |&body: &usize| !merged.is_merged[body] && !view.frame.bodies[body].is_absent;
        let mut alone: Vec<usize> = (0..ranked).filter(is_alone).collect();
        alone.sort_by(|&one, &other| self.volumes[other].total_cmp(&self.volumes[one]));
        let ranked_alone = alone.len();
        let volumes = groups.iter().map(|group| apart(group).unwrap_or(0.0).max(group.volume));
        let largest = volumes.chain(alone.first().map(|&body| self.volumes[body])).fold(0.0, f64::max);
        let rows = groups.iter().map(|group| {
            let color = palette::of_body(view.schema, group.bodies[0]);
            let mut marks = vec![(Mark::Bar(group.volume / largest), color)];
            let pieces = match group.components {
                1 => String::new(),
                components => format!("{}, ", counted(components as u64, "piece")),
            };
            let mut label =
                format!("{}: {pieces}", names(view.schema, &group.bodies, ROOM.saturating_sub(pieces.len())));
            label += &short(group.volume);
            if let Some(apart) = apart(group) {
                marks.push((Mark::Dot(apart / largest), SILVER));
                label += &format!(" (bodies {})", short(apart));
            }
            Row { label, color: SILVER, marks }
        });
        let rows = rows.chain(alone.into_iter().map(|body| {
            let (volume, color) = (self.volumes[body], palette::of_body(view.schema, body));
            let label = format!("{}: {}", view.schema.bodies[body].name, short(volume));
            Row { label, color: SILVER, marks: vec![(Mark::Bar(volume / largest), color)] }
        }));
        // what all of it encloses, and how that has changed
        let count = groups.iter().map(|group| group.components).sum::<usize>() + ranked_alone;
        let all = self.sums.zip(self.first_of_bodies).filter(|_| !groups.is_empty());
        let all = all.map(|([of_surfaces, of_bodies], first)| {
            let all = if count > 1 { format!("all {count} surfaces") } else { "all".to_owned() };
            let [overlaps, deformation] = [of_surfaces / of_bodies, of_bodies / first].map(percent);
            let labels = [
                format!("{all}: {}", short(of_surfaces)),
                format!("overlaps {overlaps} %, deformation {deformation} %"),
            ];
            labels.map(|label| Row { label, color: SILVER, marks: Vec::new() })
        });
        let rows = all.into_iter().flatten().chain(rows);
        let none =
            if merged.overlapping > 0 { "groups are drawn as overlapping meshes" } else { "no bodies are joined" };
        ranking.log(rows, none, view.at, chunks);
    }
}

/// How much a ratio is above 1 [%].
fn percent(ratio: f64) -> String {
    let change = format!("{:+.1}", 100.0 * (ratio - 1.0));
    if change == "-0.0" { "+0.0".to_owned() } else { change }
}

/// What has room beside a bar, the names of a group and the number of its pieces [characters].
const ROOM: usize = 20;

/// The names of the bodies of a group, as far as there is `room`, and the number of others.
fn names(schema: &Schema, bodies: &[usize], room: usize) -> String {
    let mut names = String::new();
    for (number, &body) in bodies.iter().enumerate() {
        let name = &schema.bodies[body].name;
        if number > 0 && names.len() + name.len() >= room {
            return format!("{names}+{}", bodies.len() - number);
        }
        names += if number > 0 { "+" } else { "" };
        names += name;
    }
    names
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
