//! What is known of a run only at its end: ranges of axes, the first event, the pairs that have plots.

use super::{
    Subject, Tab,
    camera::{NARROW, WIDE, camera_past},
    layout::{Layout, TimingsPlot, family, including},
    tabs::{PAIR_DISTANCES, SPEEDS, VOLUMES},
};
use crate::{
    observe::schema::ScalarSchema,
    sdk::{
        LogMsg, StoreId,
        blueprint::archetypes::{PlotLegend, ViewBlueprint},
    },
    stream::{
        contract::{
            DIAGNOSTIC, Entity, MARKS_AT_Q, MARKS_OF_DRAWN, MARKS_ON_AXIS, PAIR_CONTACT, PAIR_DISTANCE, PAIR_LEVEL,
            PAIR_PHASE,
        },
        focus::Focus,
        parts::{
            numbers::{Spread, is_energy},
            pairs::{self, Told},
            recent,
        },
        series::Outline,
    },
    text::{counted, significant, thousands},
};

/// Data of a run that is known only at its end.
#[derive(Clone, Debug, Default)]
pub struct Measured<'a> {
    /// Duration of the run [s].
    pub duration: f64,
    /// The durations of steps, and of their recordings [ms].
    pub durations: Option<[&'a Spread; 2]>,
    /// The largest speed [steps per second]; 0 if there is none.
    pub fastest: f64,
    /// How merging changes the volume, if it does.
    pub changed_volume: Option<String>,
    /// The axis of q, if any is plotted.
    pub distances: Option<pairs::Axis>,
    /// The entities of all lines of plots, and their outlines.
    pub lines: Vec<(&'a str, &'a Outline)>,
    /// The pairs that have plots.
    pub pairs: Told,
    /// The first and the last stage of the step at which the viewer opens, if its stages are recorded.
    pub stages: Option<[u64; 2]>,
    /// The initial focus of the viewer.
    pub focus: Option<Focus>,
    /// The times between which a flight recorder has frames [s], if there is one and it has some.
    pub kept: Option<[f64; 2]>,
    /// Number of steps whose error exceeds the tolerance.
    pub missed: u64,
    /// Whether each force term has acted on any body; empty if forces were not recorded.
    pub have_acted: &'a [bool],
}

/// The changes to [`messages`] at the end of a run. The axes of timing plots exclude outliers. The viewer opens
/// at the first event: playing it in a loop is the only way in which a layout can move the time cursor.
pub fn measured(subject: &Subject<'_>, tab: Tab, recording: &StoreId, measured: &Measured<'_>) -> Vec<LogMsg> {
    /// Ratio of a plot's upper end to the typical value …
    const HEADROOM: f64 = 1.3;
    /// … and by that further up, until what is beyond is no more than this share of all time, or the end is at `WHOLE`.
    const MOST_HIDDEN: f64 = 0.25;
    /// Ratio of the longest duration to the typical one up to which nothing is cut off.
    const WHOLE: f64 = 8.0;
    /// Nor is anything if the steps beyond that take more than this share of all time, and are more than this share of all
    /// steps: they are what the run takes, not a few interruptions.
    const MOST_TIME: f64 = 0.5;
    const FEW: f64 = 0.02;

    let mut layout = Layout::of(recording);
    let root = layout.root(subject, tab);
    layout.finish(root); // already sent; the new ids continue after its own
    for TimingsPlot { path: plot, is_recording, title } in std::mem::take(&mut layout.timings) {
        let Some(durations) = measured.durations.map(|of| of[usize::from(is_recording)]) else { continue };
        let (typical, (longest, _)) = (durations.typical(), durations.largest());
        if typical > 0.0 {
            let (count, share) = durations.beyond(WHOLE * typical);
            let is_usual = share > MOST_TIME && count as f64 > FEW * durations.count() as f64;
            let is_whole = longest <= WHOLE * typical || is_usual;
            let mut end = HEADROOM * typical;
            while end < WHOLE * typical && durations.beyond(end).1 > MOST_HIDDEN {
                end *= HEADROOM;
            }
            let [low, high] = readable([0.0, if is_whole { longest } else { end }]);
            if longest > high {
                let (count, share) = durations.beyond(high);
                let title = format!(
                    "{title}; {} cut off, up to {} ms, {:.0} % of the time",
                    counted(count, "frame"),
                    significant(longest),
                    100.0 * share
                );
                layout.log(&plot, &ViewBlueprint::update_fields().with_display_name(title));
            }
            layout.set_range(&plot, [low, high]);
        }
    }
    if let Some((scene, title)) = layout.scene.take().filter(|_| measured.missed > 0) {
        let title = format!("{title}; tolerance missed in {}: see Energy", counted(measured.missed, "step"));
        layout.log(&scene, &ViewBlueprint::update_fields().with_display_name(title));
    }
    if let Some((volumes, changed)) = layout.volumes.take().zip(measured.changed_volume.as_ref()) {
        layout.log(&volumes, &ViewBlueprint::update_fields().with_display_name(format!("{VOLUMES}, {changed}")));
    }
    if let Some(speeds) = layout.speeds.take().filter(|_| measured.fastest > 0.0) {
        // steps in which nothing happens would leave the others no room
        let usual = measured.durations.map_or(0.0, |[of_steps, _]| of_steps.typical());
        let [low, high] = readable([0.0, f64::min(measured.fastest, WHOLE * 1e3 / usual)]);
        if measured.fastest > high {
            let title = format!("{SPEEDS}; up to {}", thousands(measured.fastest as u64));
            layout.log(&speeds, &ViewBlueprint::update_fields().with_display_name(title));
        }
        layout.set_range(&speeds, [low, high]);
    }
    if let Some(pairs::Axis { ends: [low, high], .. }) = measured.distances {
        // an automatic axis would begin at 0
        for plot in layout.distances.clone() {
            layout.set_range(&plot, readable([low, high]));
        }
    }
    let owned = || subject.schema.body_scalars.iter().chain(&subject.schema.pair_scalars);
    let range_of = |scalar: &ScalarSchema| {
        let entity = DIAGNOSTIC.of(&[scalar.name]);
        measured.lines.iter().find(|(of, _)| *of == entity).and_then(|(_, outline)| outline.range)
    };
    let ranges = || subject.schema.scalars.iter().map(|scalar| (scalar, range_of(scalar)));
    let energies = ranges().filter(|(scalar, _)| is_energy(scalar.plot)).filter_map(|(_, range)| range);
    let exchanged = energies.map(|[low, high]| high - low).fold(0.0, f64::max);
    for (plot, name) in std::mem::take(&mut layout.scalars) {
        if measured.duration == 0.0 || owned().any(|scalar| scalar.plot == name) {
            continue; // as of other lines, below
        }
        let ([mut low, mut high], mut least, mut lines) = ([0.0_f64; 2], 0.0, 0); // events are marked at 0
        let mut zero: Vec<&ScalarSchema> = Vec::new();
        for (scalar, range) in ranges().filter(|(scalar, _)| scalar.plot == name) {
            let of = range.unwrap_or_default();
            (low, high) = (low.min(of[0]), high.max(of[1]));
            (least, lines) = (scalar.least_range.max(least), lines + 1);
            zero.extend((of == [0.0; 2]).then_some(scalar));
        }
        if is_energy(name) && !zero.is_empty() && zero.len() < lines {
            let left_out: Vec<String> = zero.iter().map(|scalar| including(&DIAGNOSTIC.of(&[scalar.name]))).collect();
            let mut contents =
                layout.plots.iter().find(|of| of.path == plot).map(|of| of.contents.clone()).unwrap_or_default();
            contents.retain(|line| !left_out.contains(line));
            layout.set_contents(&plot, contents);
            let labels: Vec<&str> = zero.iter().map(|scalar| scalar.label).collect();
            let title = format!("{name}; always 0: {}", labels.join(", "));
            layout.log(&plot, &ViewBlueprint::update_fields().with_display_name(title));
        }
        let range = if high - low < least { [-0.5 * least, 0.5 * least] } else { readable([low, high]) };
        if range[0] < range[1] {
            layout.set_range(&plot, range);
        }
        let largest = high.max(-low);
        if lines == 1 && largest > 0.0 {
            let share = match is_energy(name) && exchanged > 0.0 {
                true => format!(", {:.0e} of the largest exchange", largest / exchanged),
                false => String::new(),
            };
            let largest = if largest < 1e-3 { format!("{largest:.1e}") } else { significant(largest) };
            let title = format!("{name}: at most {largest}{share}");
            layout.log(&plot, &ViewBlueprint::update_fields().with_display_name(title));
        }
    }
    for (view, has_acted) in std::mem::take(&mut layout.forces).into_iter().zip(measured.have_acted) {
        if !has_acted
            && measured.duration > 0.0
            && let Some((view, name)) = view
        {
            layout.log(&view, &ViewBlueprint::update_fields().with_display_name(format!("{name} (none)")));
        }
    }
    if let Some(kept) = measured.kept {
        layout.open_at(kept);
    }
    if let Some(focus) = &measured.focus {
        match measured.stages.filter(|_| tab == Tab::Stages) {
            Some(stages) => layout.open_at_stages(stages),
            // a flight recorder may have dropped the frames of the event
            None if tab == Tab::Stages || measured.kept.is_some() => {}
            None => layout.open_at(focus.interval(measured.duration)),
        }
        let spaces = std::mem::take(&mut layout.spaces);
        for aspect in [WIDE, NARROW] {
            // the arrangement of several variants is for the view from the front, and so are the places of names; among many
            // bodies, the pair is also drawn alone
            let is_turned = subject.schema.variants.is_empty() && !recent::is_drawn_alone(subject.schema);
            let (pair, others) = match is_turned {
                true => (focus.pair.as_slice(), focus.others.as_slice()),
                false => Default::default(),
            };
            let camera = camera_past(&focus.spheres, pair, others, aspect, layout.arrangement);
            for (view, _) in spaces.iter().filter(|(_, of)| *of == aspect) {
                layout.log(&format!("{view}/EyeControls3D"), &camera);
            }
        }
    }
    let Told { moving, left_out, changed, met, all } = &measured.pairs;
    let drawn = if *left_out > 0 {
        format!("q of {} of {} pairs with plots, those with changes first", moving.len(), moving.len() + left_out)
    } else {
        PAIR_DISTANCES.to_owned()
    };
    // far thresholds would leave the lines of q no room
    let beyond = measured.distances.iter().flat_map(|axis| &axis.beyond);
    let beyond = beyond.map(|&(a, b)| subject.schema.pair_name(a, b));
    let beyond: Vec<String> = beyond.filter(|pair| *left_out == 0 || moving.contains(pair)).collect();
    let title = match beyond.as_slice() {
        [] => drawn,
        [pair] => format!("{drawn}; thresholds of {pair} beyond the axis"),
        pairs => format!("{drawn}; thresholds of {} pairs beyond the axis", pairs.len()),
    };
    if title != PAIR_DISTANCES {
        for plot in &layout.distances.clone() {
            layout.log(plot, &ViewBlueprint::update_fields().with_display_name(title.as_str()));
        }
    }
    let is_shorter = moving.len() < *all || changed.len() < *all || met.len() < *all;
    if is_shorter || (!pairs::has_named_pairs(subject.schema) && *all > 0) {
        // the pairs that have plots, and what they plot, are known only now
        let mut lines = vec![family(&MARKS_AT_Q)];
        if *left_out > 0 {
            // marks of events on lines that are left out would be puzzling
            lines = vec![family(&MARKS_OF_DRAWN), including(&MARKS_AT_Q.of(&["ends"]))];
        }
        for (plot, measure) in std::mem::take(&mut layout.measures) {
            let lines = moving.iter().map(|pair| including(&measure.of(&[pair])));
            layout.set_contents(&plot, lines.chain([family(&MARKS_ON_AXIS)]).collect());
        }
        for pair in moving {
            lines.push(including(&PAIR_DISTANCE.of(&[pair])));
            let levels = subject.schema.thresholds.iter().map(|threshold| PAIR_LEVEL.of(&[pair, threshold.name]));
            lines.extend(levels.map(|level| including(&level)));
        }
        let lanes = |of: &Entity, pairs: &[String]| pairs.iter().map(|pair| including(&of.of(&[pair]))).collect();
        let views = [
            (std::mem::take(&mut layout.distances), lines),
            (std::mem::take(&mut layout.phases), lanes(&PAIR_PHASE, changed)),
            (std::mem::take(&mut layout.contacts), lanes(&PAIR_CONTACT, met)),
        ];
        for (paths, lines) in views {
            paths.iter().for_each(|path| layout.set_contents(path, lines.clone()));
        }
    }
    let ranges = layout.plots.iter().filter(|plot| plot.range.is_none() && measured.duration > 0.0);
    let ranges = ranges.filter_map(|plot| Some((plot.path.clone(), readable(plot.values(&measured.lines)?))));
    let ranges: Vec<(String, [f64; 2])> = ranges.filter(|(_, [low, high])| low < high).collect();
    ranges.into_iter().for_each(|(plot, range)| layout.set_range(&plot, range));
    for plot in std::mem::take(&mut layout.plots) {
        let opening = measured.focus.as_ref().map(|focus| (focus.time / subject.schema.dt).ceil());
        let corner = plot.emptiest_corner(&measured.lines, opening);
        if corner != plot.corner {
            layout.log(&format!("{}/PlotLegend", plot.path), &PlotLegend::update_fields().with_corner(corner));
        }
    }
    let messages = layout.chunks.take();
    if messages.is_empty() { messages } else { layout.activate(messages) }
}

/// The range of an axis that has numbers: the viewer labels the multiples of a power of ten, unless they are dense. Some
/// more is shown where that lets it label two of them.
fn readable([mut low, mut high]: [f64; 2]) -> [f64; 2] {
    /// Multiples that have labels in a plot of usual height.
    const LABELLED: f64 = 8.0;
    const MARGIN: f64 = 0.04;

    let spacing = 10f64.powf(((high - low) / LABELLED).log10().ceil());
    for _ in 0..2 {
        let [first, last] = [(low / spacing).ceil(), (high / spacing).floor()];
        if last - first < 1.0 {
            let [below, above] = [(first - 1.0) * spacing, (last + 1.0) * spacing];
            if low - below < above - high { low = below } else { high = above }
        }
    }
    let margin = MARGIN * (high - low);
    [low - margin, high + margin]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_a_labelled_number_beside_zero() {
        for (range, expected) in [
            ([0.0, 3.0], [0.0, 3.0]),
            ([0.0, 0.819], [0.0, 1.0]),
            ([-4.4e4, 8.6e4], [-4.4e4, 1e5]),
            ([-8.0, 1.0], [-10.0, 1.0]),
            ([0.0, 4.8e-7], [0.0, 4.8e-7]),
            ([8.5, 9.4], [8.0, 9.4]),
            ([100.3, 100.7], [100.3, 100.7]),
            ([1000.05, 1000.95], [1000.0, 1001.0]),
        ] {
            let [low, high] = readable(range);
            let margin = 0.04 * (expected[1] - expected[0]);
            let error = f64::max((low + margin - expected[0]).abs(), (high - margin - expected[1]).abs());
            assert!(error <= 1e-12 * margin.max(1e-3), "{range:?}: {low} {high}");
        }
        let empty = readable([0.0, 0.0]);
        assert!(empty[0].partial_cmp(&empty[1]) != Some(std::cmp::Ordering::Less), "no range: {empty:?}");
    }
}
