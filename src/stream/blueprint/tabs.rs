//! The tabs of the layout of a run, one function each.

use glam::DVec3;

use super::{
    Subject, Tab,
    camera::{Framing, NARROW, WIDE},
    layout::{Layout, Part, TimingsPlot, VERTICES, family, including},
};
use crate::{
    colors,
    observe::Schema,
    sdk::{
        self, Mesh3D, Points3D,
        blueprint::{
            archetypes::{ContainerBlueprint, EntityBehavior, VisibleTimeRanges},
            components::{ContainerKind, Corner2D, VisibleTimeRange},
        },
        datatypes::{self, TimeRange, TimeRangeBoundary},
    },
    stream::{
        contract::{
            ABOUT, ABOUT_STAGES, ACCURACY, ARROWS, BODY, BODY_DISPLACEMENT, BODY_FORCE, BODY_SCALAR, BODY_SURFACE,
            DEFORMING, DIAGNOSTIC, EVENTS, Entity, FORCE, FURTHEST, INFLUENCE, LAG, LARGEST, LEGEND, MARKS_AT_Q,
            MERGED, MERGED_SURFACE, MOVES, NAMES, NOT_RECORDED, PAIR_CONTACT, PAIR_DISTANCE, PAIR_GAP, PAIR_NECK,
            PAIR_OVERLAP, PAIR_PHASE, PAIR_SCALAR, PLANE, POINTS, RANKED_DISPLACEMENTS, RANKED_FORCES, RANKED_GROUPS,
            RANKED_PAIRS, RANKED_STAGES, RECENT_NAMES, RECENT_PAIR, RECENT_SPHERES, RESTING, RESULTANT_LABELS,
            RESULTANTS, SIM_TIME, SPEED, STAGE, STAGES, STEP, STRONGEST, TOUCHING, TRAILS, VOLUME, WORLD,
        },
        palette,
        parts::{
            body_forces, forces, groups, heat, numbers,
            pairs::{self, MEASURES},
            ranking::{self, is_ranked},
            recent, trails,
        },
        settings::{Detail, Entities, Settings},
    },
};

/// The title of plots of distances.
pub const PAIR_DISTANCES: &str = "Pair distances q and their thresholds";

/// The title of the plot of volumes.
pub const VOLUMES: &str = "Volume [unit³]";

/// The title of plots of the stages of a step.
const TIMINGS: &str = "Timings, ms per step";

/// Upper limit on the number of bodies that are drawn transparent in views of forces.
const MAX_SHEER: usize = 64;

impl Layout {
    /// All tabs, of which `front` is shown first.
    pub fn root(&mut self, subject: &Subject<'_>, front: Tab) -> Part {
        let Subject { simulation, schema, settings } = *subject;
        let framing = simulation.framing(false);
        let close = simulation.framing(true);
        self.set_arrangement(schema, &framing);
        if front == Tab::Stages {
            self.timeline = STAGE;
        }
        let first = match schema.variants.is_empty() {
            true => self.scene_tab(&framing, schema, settings),
            false => self.variants_tab(&framing, schema, settings),
        };
        let mut tabs = vec![(Tab::Scene, first)];
        if schema.bodies.len() > 1 {
            tabs.push((Tab::Surface, self.surface_tab(&close, schema, settings)));
        }
        if settings.detail != Detail::Surface {
            tabs.push((Tab::Forces, self.forces_tab(&close, schema, settings)));
            tabs.push((Tab::Displacement, self.displacement_tab(&close, schema, settings)));
        }
        if schema.bodies.len() > 1 {
            tabs.push((Tab::Pairs, self.pairs_tab(schema)));
        }
        tabs.push((Tab::Timings, self.timings_tab(schema)));
        tabs.push((Tab::Energy, self.energy_tab(schema)));
        if matches!(settings.detail, Detail::Stages { .. }) {
            tabs.push((Tab::Stages, self.stages_tab(&framing, schema, settings)));
        }
        let active = tabs.iter().find(|(tab, _)| *tab == front).map(|(_, part)| part.path.clone());
        let root =
            self.container(ContainerKind::Tabs, "meldscope", tabs.into_iter().map(|(_, part)| part).collect(), &[]);
        if let Some(active) = active {
            self.log(&root.path, &ContainerBlueprint::update_fields().with_active_tab(active.as_str()));
        }
        root
    }

    /// An overview of everything.
    fn scene_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let scene_view = self.scene_view((framing, WIDE), schema, scene_title(schema), settings);
        self.scene = Some((scene_view.path.clone(), scene_title(schema)));
        let about = self.view("TextDocument", "Legend", ABOUT.path, &[including(ABOUT.path)], &[]);
        let left = self.container(ContainerKind::Vertical, "Space", vec![scene_view, about], &[2.6, 1.0]);
        let right = if schema.bodies.len() > 1 {
            // a lane for each pair, as far as there is room
            let mut parts = self.pair_views(schema);
            if is_ranked(schema) {
                // as many names would cover half of a small plot, and lanes of all pairs have no room
                self.hide_legend(&parts[0]);
                parts[1] = self.ranking(NEXT, RANKED_PAIRS.path);
            }
            let shares = match schema.bodies.len() {
                2 => [1.4, 0.5, 1.2, 0.8],
                _ if recent::is_drawn_alone(schema) => [0.9, 1.2, 1.25, 1.15],
                _ if is_ranked(schema) => [1.1, 1.0, 1.15, 0.65],
                _ => [1.25, 1.05, 1.1, 0.8],
            };
            parts.push(match recent::is_drawn_alone(schema) {
                true => self.recent_pair(),
                false => self.small_timings(schema),
            });
            self.container(ContainerKind::Vertical, "Time", parts, &shares)
        } else {
            // a single body: show its motion and its timings
            let mut parts: Vec<Part> = self.diagnostics(schema, 2).into_iter().map(|(_, plot)| plot).collect();
            parts.push(self.small_timings(schema));
            let shares = vec![1.0; parts.len()];
            self.container(ContainerKind::Vertical, "Time", parts, &shares)
        };
        self.container(ContainerKind::Horizontal, "Scene", vec![left, right], &[1.6, 1.0])
    }

    /// The surfaces of several variants of a scene, and what differs between them.
    fn variants_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let view = self.surface_view((framing, WIDE), "The same bodies in each model", schema, settings);
        let about = self.view("TextDocument", "Legend", ABOUT.path, &[including(ABOUT.path)], &[]);
        let left = self.container(ContainerKind::Vertical, "Space", vec![view, about], &[2.6, 1.0]);
        let title = "Volume of all surfaces, by model [unit³]";
        let mut parts = vec![
            // no marks of events, which are at 0: a change of a hundredth is visible
            self.time_series(title, "/", &[family(&VOLUME)], Corner2D::LeftBottom),
            self.lanes("Pairs whose surfaces touch, by model", TOUCHING.family(), &[family(&TOUCHING)]),
        ];
        if let Some(plot) = schema.scalars.first().map(|scalar| scalar.plot) {
            let lines = schema.scalars.iter().filter(|scalar| scalar.plot == plot);
            let lines: Vec<String> = lines.map(|scalar| including(&DIAGNOSTIC.of(&[scalar.name]))).collect();
            let plot = self.time_series(plot, "/", &lines, Corner2D::LeftTop);
            // the lines have the colours of those above
            self.hide_legend(&plot);
            parts.push(plot);
        }
        parts.push(self.events());
        let right = self.container(ContainerKind::Vertical, "What differs", parts, &[1.0, 1.4, 0.8, 0.9]);
        self.container(ContainerKind::Horizontal, "Models", vec![left, right], &[1.6, 1.0])
    }

    /// A 3D view of everything, with the forces that make bodies merge and split.
    pub fn scene_view(&mut self, framing: Framing<'_>, schema: &Schema, name: &str, settings: &Settings) -> Part {
        let view = self.space(framing, name, &[family(&WORLD)]);
        for (index, surface) in surfaces(schema, settings).into_iter().enumerate() {
            let mut of = Mesh3D::update_fields();
            if draws_springs(schema, settings) && settings.entities == Entities::Body {
                of = of.with_albedo_factor(palette::sheer(palette::of_body(schema, index)));
            }
            self.draw_unmerged(&view, &surface, &of);
        }
        if schema.bodies.len() > 1 {
            self.draw_lit(&view, MERGED_SURFACE.path, &Mesh3D::update_fields());
        }
        self.draw_resting(&view, schema, settings);
        let mut hide = |entity: &str| {
            let path = format!("{}/ViewContents/overrides{entity}/visualizers", view.path);
            self.log(&path, &EntityBehavior::new().with_visible(false));
        };
        // what is hidden can be enabled in the view's entity list: among many bodies, one would see nothing else
        let is_crowd = recent::is_drawn_alone(schema);
        if is_crowd {
            hide(INFLUENCE.path);
            hide(TRAILS.path);
            forces::NET_KINDS.iter().for_each(|(name, ..)| hide(&FORCE.of(&[name])));
        }
        if settings.detail != Detail::Surface {
            hide(RESULTANTS.path);
            hide(RESULTANT_LABELS.path);
            for term in schema.terms.iter().filter(|term| is_crowd || !term.is_shown) {
                hide(&FORCE.of(&[term.name]));
            }
        }
        if settings.entities == Entities::Body && schema.bodies.iter().any(|body| body.is_free) {
            let seconds = (-trails::SECONDS * 1e9) as i64;
            let ranges = [(SIM_TIME, seconds), (STEP, (-trails::SECONDS / schema.dt) as i64)].map(|(line, start)| {
                VisibleTimeRange(datatypes::VisibleTimeRange {
                    timeline: line.into(),
                    range: TimeRange {
                        start: TimeRangeBoundary::CursorRelative(start.into()),
                        end: TimeRangeBoundary::CursorRelative(0.into()),
                    },
                })
            });
            let path = format!("{}/ViewContents/overrides{}", view.path, TRAILS.path);
            self.log(&path, &VisibleTimeRanges::new(ranges.clone()));
            self.log(&format!("{path}/visualizers"), &VisibleTimeRanges::new(ranges));
        }
        view
    }

    /// The pair of the last event, cut out of everything that may hide it.
    fn recent_pair(&mut self) -> Part {
        let contents = [&RECENT_PAIR, &RECENT_SPHERES, &RECENT_NAMES].map(|of| including(of.path));
        let ground = self.ground.take();
        let framing: Framing<'_> = (&[(DVec3::ZERO, 2.1)], WIDE);
        let view = self.space(framing, "The pair of the last event, alone", &contents);
        self.ground = ground;
        self.spaces.pop(); // its camera stays
        self.draw_lit(&view, RECENT_PAIR.path, &Mesh3D::update_fields());
        view
    }

    /// The surfaces of groups, and the gap and overlap of pairs above their phases; of more than a few bodies, which of them are
    /// one now.
    fn surface_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let view = self.surface_view((framing, NARROW), "One surface per group", schema, settings);
        let mut plots = Vec::new();
        if pairs::has_named_pairs(schema) {
            let measures =
                [("Gap [R]", &PAIR_GAP), ("Neck [R]", &PAIR_NECK), ("Overlap [R³]; a ball: 4.19", &PAIR_OVERLAP)];
            plots.extend(measures.map(|(title, measure)| {
                let contents: Vec<String> = pairs::named(schema, measure).map(|line| including(&line)).collect();
                let plot = self.plot(title, "/", &contents, Corner2D::RightTop);
                if is_ranked(schema) {
                    self.hide_legend(&plot); // as many names would cover half of it
                }
                self.measures.push((plot.path.clone(), measure));
                plot
            }));
        }
        let [joined, touching, both] =
            [pairs::JOINED, pairs::TOUCHING, pairs::TOGETHER].map(|of| colors::name(pairs::CONTACTS[of].1));
        let title = format!("Contact: {joined} joined, {touching} touching, {both} both");
        let mut contents: Vec<String> = pairs::named(schema, &PAIR_PHASE).map(|lane| format!("- {lane}")).collect();
        contents.push(family(&PAIR_PHASE));
        let contacts = self.lanes(&title, PAIR_PHASE.family(), &contents);
        self.contacts.push(contacts.path.clone());
        let mut parts = match is_ranked(schema) {
            true => {
                let title = match groups::has_volume(schema) {
                    true => "Groups now: volume; dot: its bodies one by one [unit³]",
                    false => "Groups now: volume [unit³]",
                };
                let ranking = self.ranking(title, RANKED_GROUPS.path);
                plots.insert(0, contacts);
                vec![ranking, self.container(ContainerKind::Tabs, "Pairs", plots, &[])]
            }
            false => vec![self.container(ContainerKind::Tabs, "Pairs", plots, &[]), contacts],
        };
        if groups::has_volume(schema) {
            // no marks of events, which are at 0: a change of a hundredth is visible
            let plot = self.time_series(VOLUMES, "/", &[family(&VOLUME)], Corner2D::LeftBottom);
            self.volumes = Some(plot.path.clone());
            parts.push(plot);
        }
        parts.push(self.events());
        let mut shares = vec![1.0; parts.len()];
        if is_ranked(schema) {
            shares[0] = 1.7; // rows have the height of their labels
        }
        let right = self.container(ContainerKind::Vertical, "Measures", parts, &shares);
        self.container(ContainerKind::Horizontal, "Surface", vec![view, right], &[1.6, 1.0])
    }

    /// One surface for each group of bodies.
    pub fn surface_view(&mut self, framing: Framing<'_>, name: &str, schema: &Schema, settings: &Settings) -> Part {
        // a seam lies inside the smooth surface and would show through in places
        let merged = if schema.blend > 0.0 { including(MERGED_SURFACE.path) } else { family(&MERGED) };
        let bodies = [&BODY, &DEFORMING, &RESTING, &PLANE, &NAMES, &NOT_RECORDED].map(family);
        let contents = [&bodies[..], &[merged]].concat();
        let view = self.space(framing, name, &contents);
        for (index, surface) in surfaces(schema, settings).into_iter().enumerate() {
            // a batch has a colour per vertex
            let rgb = if settings.entities == Entities::Batch { [0xFF; 3] } else { palette::of_body(schema, index) };
            self.draw_unmerged(&view, &surface, &Mesh3D::update_fields().with_albedo_factor(palette::opaque(rgb)));
        }
        let opaque = Mesh3D::update_fields().with_albedo_factor(sdk::Rgba32::WHITE);
        self.draw_lit(&view, MERGED_SURFACE.path, &opaque);
        self.draw_resting(&view, schema, settings);
        view
    }

    /// Views of the resultant of each cause on each body, of all forces at vertices, and of each force that can act in the
    /// scene, of which the first is in front, and the net force on each body over time. All views have the same initial
    /// camera; Rerun 0.36 cannot link two of them.
    pub fn forces_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let sums = schema.sum_of_terms().map(|sum| schema.terms[sum].name).into_iter();
        let sums = sums.chain(forces::NET_KINDS.map(|(name, ..)| name));
        let mut arrows: Vec<String> = sums.map(|name| format!("- {}", FORCE.of(&[name]))).collect();
        arrows.push(family(&FORCE));
        // a resultant is labelled with its body
        let resultants = [family(&RESULTANTS), format!("- {}", NAMES.path)];
        let mut views = vec![self.forces_view(framing, "By body", &resultants, schema, settings)];
        // arrows of several scales in one view would be compared
        let mut scales = schema.terms.iter().filter(|term| term.can_act).map(|term| schema.arrow_scale_of(term));
        let first = scales.next();
        if scales.all(|scale| Some(scale) == first) {
            views.push(self.forces_view(framing, "All", &arrows, schema, settings));
        }
        for term in &schema.terms {
            if !term.can_act {
                self.forces.push(None);
                continue;
            }
            let name = capitalized(term.name);
            let view = self.forces_view(framing, &name, &[including(&FORCE.of(&[term.name]))], schema, settings);
            self.forces.push(Some((view.path.clone(), name)));
            views.push(view);
        }
        let causes = self.container(ContainerKind::Tabs, "Causes", views, &[]);
        let scale = including(ARROWS.path);
        let scale = self.view("TextDocument", "What arrows and lines mean", ARROWS.path, &[scale], &[]);
        let causes = self.container(ContainerKind::Vertical, "Forces", vec![causes, scale], &[4.2, 1.0]);
        let is_ranked = is_ranked(schema);
        let of_bodies = if schema.bodies.len() > body_forces::MOST_BODIES { &[] } else { schema.bodies.as_slice() };
        let strongest = is_ranked.then(|| {
            let title = "Strongest on any body, by cause [unit/s²]";
            let plot = self.plot(title, "/", &[family(&STRONGEST)], Corner2D::RightTop);
            self.hide_legend(&plot); // it would cover half of the lines; the panel below the arrows names the colours
            plot
        });
        let mut plots: Vec<Part> = strongest.into_iter().collect();
        plots.extend(of_bodies.iter().enumerate().map(|(index, body)| {
            let title = match !is_ranked {
                true => format!("Force on {} by cause, over its mass [unit/s²]", body.name),
                false => format!("{} [unit/s²]", body.name),
            };
            let contents = format!("+ {}/{}/**", BODY_FORCE.family(), body.name);
            let plot = self.plot(&title, "/", &[contents], Corner2D::RightTop);
            if !is_ranked && (index > 0 || schema.bodies.len() > 2) {
                // the lines have the same colours in all plots; a legend covers half of a small one
                self.hide_legend(&plot);
            }
            plot
        }));
        let shares = vec![1.0; plots.len()];
        let kind = if is_ranked { ContainerKind::Tabs } else { ContainerKind::Vertical };
        let plots = self.container(kind, "Net forces", plots, &shares);
        let title = match is_ranked {
            true => "Bodies with the largest net forces now [unit/s²]; dots: causes",
            false => "The strongest forces on bodies now [unit/s²]",
        };
        let ranking = self.ranking(title, RANKED_FORCES.path);
        let share = if is_ranked { 1.0 } else { schema.bodies.len() as f32 };
        let plots = self.container(ContainerKind::Vertical, "Strongest", vec![ranking, plots], &[1.2, share]);
        self.container(ContainerKind::Horizontal, "Forces", vec![causes, plots], &[1.6, 1.0])
    }

    /// Arrows on translucent bodies.
    fn forces_view(
        &mut self,
        framing: &[(DVec3, f64)],
        name: &str,
        arrows: &[String],
        schema: &Schema,
        settings: &Settings,
    ) -> Part {
        const WHITE: palette::Rgb = [0xFF; 3];
        let bodies = [&BODY, &DEFORMING, &PLANE, &NAMES, &POINTS, &NOT_RECORDED].map(family);
        let view = self.space((framing, WIDE), name, &[&bodies[..], arrows].concat());
        self.keep_camera(settings);
        if schema.bodies.len() <= MAX_SHEER || settings.entities == Entities::Batch {
            for (index, surface) in surfaces(schema, settings).into_iter().enumerate() {
                // a batch has a colour per vertex
                let rgb = if settings.entities == Entities::Batch { WHITE } else { palette::of_body(schema, index) };
                let sheer = Mesh3D::update_fields().with_albedo_factor(palette::sheer(rgb));
                self.draw_lit(&view, &surface, &sheer);
            }
        }
        view
    }

    /// The last view leaves out bodies at rest that have no entity of their own, as the camera does that it has.
    fn keep_camera(&mut self, settings: &Settings) {
        if settings.entities == Entities::Batch {
            self.spaces.pop();
        }
    }

    /// Surfaces coloured by displacement, above their scale; the largest displacements, now and over time.
    fn displacement_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let view = self.displacement_view(framing, schema, settings);
        let mut right = Vec::new();
        if is_ranked(schema) {
            let title = "Bodies with the largest displacements now: vertex [radii]";
            right.push(self.ranking(title, RANKED_DISPLACEMENTS.path));
        }
        if schema.bodies.len() <= body_forces::MOST_BODIES {
            let title = "Largest displacement of each body [radii]";
            let lines = self.plot(title, "/", &[family(&BODY_DISPLACEMENT)], Corner2D::RightTop);
            if is_ranked(schema) {
                self.hide_legend(&lines); // the ranking names the colours
            }
            right.push(lines);
        }
        if right.len() < 2 {
            right.push(self.events());
        }
        let right = self.container(ContainerKind::Vertical, "Largest", right, &[1.0, 1.0]);
        self.container(ContainerKind::Horizontal, "Displacement", vec![view, right], &[1.8, 1.0])
    }

    /// Surfaces coloured by displacement, with selectable vertices, above the colour scale.
    pub fn displacement_view(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let names = if heat::are_bodies_labelled(schema) { &LARGEST } else { &NAMES };
        let contents = [&BODY, &DEFORMING, &PLANE, &LARGEST, names, &NOT_RECORDED].map(family);
        let title = "Displacement from rest; select a vertex to see its numbers";
        let view = self.space((framing, WIDE), title, &contents);
        self.keep_camera(settings);
        let white = sdk::Rgba32::WHITE;
        let opaque = Mesh3D::update_fields().with_albedo_factor(white).with_vertex_colors([white]);
        // on many, small bodies they would hide the colours
        let radius = if is_ranked(schema) { 1.5 } else { 2.5 };
        let dots = Points3D::update_fields()
            .with_radii([sdk::Radius::new_ui_points(radius)])
            .with_colors([palette::color(palette::DOT)]);
        for surface in surfaces(schema, settings) {
            self.visualize(
                &view.path,
                &surface,
                &[("Mesh3D", &heat::MAPPINGS, &opaque), ("Points3D", &[VERTICES], &dots)],
            );
        }
        let scale = self.view(
            "2D",
            "Displacement [radii], on the scale of this step",
            LEGEND.family(),
            &[family(&LEGEND)],
            &[],
        );
        self.container(ContainerKind::Vertical, "Displacement", vec![view, scale], &[6.0, 1.0])
    }

    /// Views of pair distances, phases and events.
    fn pair_views(&mut self, schema: &Schema) -> Vec<Part> {
        // a pattern cannot have its wildcard in the middle
        let without = |parts: &[&Entity]| -> Vec<String> {
            let left_out = parts.iter().flat_map(|part| pairs::named(schema, part)).map(|line| format!("- {line}"));
            std::iter::once(family(&PAIR_DISTANCE)).chain(left_out).collect()
        };
        let mut contents = without(&MEASURES.map(|(measure, ..)| measure));
        contents.push(family(&MARKS_AT_Q));
        let distances = self.time_series(PAIR_DISTANCES, "/", &contents, Corner2D::RightBottom);
        self.distances.push(distances.path.clone());
        let contents = without(&[&PAIR_CONTACT]);
        let phases = self.lanes("Pair phases", PAIR_PHASE.family(), &contents);
        self.phases.push(phases.path.clone());
        let events = self.events();
        vec![distances, phases, events]
    }

    /// Distances, phases and events of pairs; of many, also which of them matter now.
    fn pairs_tab(&mut self, schema: &Schema) -> Part {
        let mut parts = self.pair_views(schema);
        if !is_ranked(schema) {
            return self.container(ContainerKind::Vertical, "Pairs", parts, &[2.0, 1.0, 0.8]);
        }
        let right = vec![self.ranking(NEXT, RANKED_PAIRS.path), parts.remove(2)];
        let left = self.container(ContainerKind::Vertical, "Over time", parts, &[1.0, 1.0]);
        let right = self.container(ContainerKind::Vertical, "Now", right, &[1.3, 1.0]);
        self.container(ContainerKind::Horizontal, "Pairs", vec![left, right], &[1.5, 1.0])
    }

    /// The events of pairs and bodies. Steps beyond the tolerance, which may be all of them, are listed beside the error.
    fn events(&mut self) -> Part {
        let contents = [format!("+ {}/**", EVENTS.path), format!("- {}", ACCURACY.path)];
        self.listed("Events", EVENTS.path, &contents)
    }

    /// The cost of a step and of its recording, each as stacked stages, and the resulting speed.
    fn timings_tab(&mut self, schema: &Schema) -> Part {
        let stages = [
            ("Timings, ms per step without waits, stacked (observe: copying states, finding touches)", false),
            ("Recording on its own thread, ms per step: extract makes surfaces, log encodes", true),
        ];
        let stages: Vec<Part> = stages.map(|(title, is_recording)| self.stacked(title, schema, is_recording)).into();
        for plot in &stages {
            // the ranking names the colours
            self.hide_legend(plot);
        }
        let stages = self.container(ContainerKind::Vertical, "Stages", stages, &[1.6, 1.0]);
        let title = "Total of each stage, share of the run; longest [ms], its step; +: other threads";
        let sums = vec![self.ranking(title, RANKED_STAGES.path), self.speed()];
        let ranked = ranking_height(ranking::ROWS);
        let sums = self.container(ContainerKind::Vertical, "Sums", sums, &[ranked, COLUMN - ranked]);
        self.container(ContainerKind::Horizontal, "Timings", vec![stages, sums], &[1.6, 1.0])
    }

    /// Without a legend, which would hide the lines of a small plot.
    fn small_timings(&mut self, schema: &Schema) -> Part {
        let plot = self.stacked(TIMINGS, schema, false);
        self.hide_legend(&plot);
        plot
    }

    /// The stages of a step, or of its recording.
    fn stacked(&mut self, title: &str, schema: &Schema, is_recording: bool) -> Part {
        let stages = numbers::timings(schema).filter(|stage| numbers::is_work(stage));
        let stages = stages.filter(|stage| numbers::RECORDING.contains(stage) == is_recording);
        let contents: Vec<String> = stages.map(|stage| including(&numbers::stacked(schema, stage))).collect();
        let plot = self.plot(title, "/", &contents, Corner2D::LeftTop);
        self.timings.push(TimingsPlot { path: plot.path.clone(), is_recording, title: title.to_owned() });
        plot
    }

    fn speed(&mut self) -> Part {
        let contents = [&SPEED, &LAG].map(|line| including(line.path));
        let plot = self.plot(SPEEDS, "/", &contents, Corner2D::LeftTop);
        // it would cover the first steps
        self.hide_legend(&plot);
        self.speeds = Some(plot.path.clone());
        plot
    }

    /// Energies and what changed them over time, above the other scalars, one at a time; beside them their numbers at the
    /// instant, and the events that made energies jump.
    fn energy_tab(&mut self, schema: &Schema) -> Part {
        let ranked = numbers::energies(schema);
        let number_of = |name: &str| ranked.iter().position(|(plot, _)| *plot == name);
        let mut others = Vec::new();
        let (mut left, mut right, mut heights) = (Vec::new(), Vec::new(), Vec::new());
        for (name, plot) in self.diagnostics(schema, usize::MAX) {
            let Some(number) = number_of(name) else {
                let first = if numbers::is_energy(name) { 0 } else { others.len() };
                others.insert(first, plot);
                continue;
            };
            self.hide_legend(&plot); // the ranking names the colours
            let title = format!("Now: {}", name.split(';').next().unwrap_or(name));
            let rows = ranked[number].1.len().min(ranking::ROWS);
            left.push(plot);
            right.push(self.ranking_of(rows, &title, &numbers::ranked_energies(number)));
            heights.push(ranking_height(rows));
        }
        let events = self.lines("Events, and steps beyond the tolerance", EVENTS.path);
        // a model without energies has room for its other scalars
        let kind = if left.is_empty() { ContainerKind::Vertical } else { ContainerKind::Tabs };
        left.push(self.container(kind, "Others", others, &[]));
        right.push(events);
        heights.push(f32::max(COLUMN - heights.iter().sum::<f32>(), 0.3 * COLUMN));
        let left = self.container(ContainerKind::Vertical, "Over time", left, &[]);
        let right = self.container(ContainerKind::Vertical, "Now", right, &heights);
        self.container(ContainerKind::Horizontal, "Energy", vec![left, right], &[1.5, 1.0])
    }

    /// Plots of the schema's scalars, with their names.
    fn diagnostics(&mut self, schema: &Schema, most: usize) -> Vec<(&'static str, Part)> {
        let mut plots: Vec<(&'static str, Vec<String>)> = Vec::new();
        let lines = schema.scalars.iter().map(|scalar| (scalar.plot, including(&DIAGNOSTIC.of(&[scalar.name]))));
        let owned = [(&BODY_SCALAR, &schema.body_scalars), (&PAIR_SCALAR, &schema.pair_scalars)];
        let owned = owned.into_iter().flat_map(|(of, scalars)| {
            scalars.iter().map(|scalar| (scalar.plot, format!("+ {}/{}/**", of.family(), scalar.name)))
        });
        for (name, line) in lines.chain(owned) {
            match plots.iter_mut().find(|(plot, _)| *plot == name) {
                Some((_, lines)) => lines.push(line),
                None => plots.push((name, vec![line])),
            }
        }
        let mut plot = |(name, lines): (&'static str, Vec<String>)| {
            let plot = self.plot(name, "/", &lines, Corner2D::RightTop);
            self.scalars.push((plot.path.clone(), name));
            (name, plot)
        };
        plots.into_iter().take(most).map(&mut plot).collect()
    }

    /// The stages inside steps, on the timeline `stage`.
    fn stages_tab(&mut self, framing: &[(DVec3, f64)], schema: &Schema, settings: &Settings) -> Part {
        let title = "Inside a step (choose the timeline stage, bottom left)";
        let view = self.scene_view((framing, NARROW), schema, title, settings);
        self.set_contents(&view.path, vec![family(&WORLD), including(MOVES.path), including(FURTHEST.path)]);
        let about = self.view("TextDocument", "About stages", ABOUT_STAGES.path, &[including(ABOUT_STAGES.path)], &[]);
        let lines = self.lines("Stages", STAGES.path);
        let list = self.container(ContainerKind::Vertical, "Stages", vec![about, lines], &[1.4, 5.0]);
        self.container(ContainerKind::Horizontal, "Stages", vec![view, list], &[1.3, 1.0])
    }
}

/// The title of the plot of speeds.
pub const SPEEDS: &str = "Steps per second, waits included; orange: lag of --realtime [ms]";

/// The height of a window in rows of a ranking in its right column.
const COLUMN: f32 = 27.0;

/// The height of a ranking with its title, in rows.
fn ranking_height(rows: usize) -> f32 {
    rows as f32 + 1.4
}

/// The title of the ranking of pairs.
const NEXT: &str = "Next phase changes of pairs within reach, extrapolated";

/// The title of the view of everything.
pub fn scene_title(schema: &Schema) -> &'static str {
    match schema.bodies.iter().all(|body| body.reach == 0.0) && schema.points.is_empty() {
        _ if recent::is_drawn_alone(schema) => "Bodies, and the pair of the last event",
        true => "Bodies, forces",
        false => "Bodies, influence spheres, forces",
    }
}

/// A name as a title.
pub fn capitalized(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect()
}

/// Whether springs are recorded.
pub fn draws_springs(schema: &Schema, settings: &Settings) -> bool {
    settings.detail != Detail::Surface && schema.bodies.iter().any(|body| body.has_springs)
}

/// The entities of deformable surfaces.
pub fn surfaces(schema: &Schema, settings: &Settings) -> Vec<String> {
    match settings.entities {
        Entities::Body => schema.bodies.iter().map(|body| BODY_SURFACE.of(&[&body.name])).collect(),
        Entities::Batch => vec![DEFORMING.path.to_owned()],
    }
}
