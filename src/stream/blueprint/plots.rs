//! Plots over time: the range of their values, and where their legends cover no data.

use crate::{
    sdk::blueprint::components::Corner2D,
    stream::{contract::MARKS_ON_AXIS, series::Outline},
};

/// The width of a legend, and the height of each of its lines, as fractions of its plot's. No legend is higher than its
/// plot, in which it scrolls.
const WIDTH: f64 = 0.3;
const HEIGHT: f64 = 0.13;
/// What is at an instant, as a fraction of the width.
const NEAR: f64 = 0.03;

/// A plot over time whose legend has a corner.
pub struct Plot {
    pub path: String,
    /// What it shows, as rules of a view's contents.
    pub contents: Vec<String>,
    /// The corner of the legend.
    pub corner: Corner2D,
    /// The ends of the axis of values; those of the lines if there are none.
    pub range: Option<[f64; 2]>,
}

impl Plot {
    /// Whether an entity has a line in the plot.
    fn shows(&self, entity: &str) -> bool {
        let names = |rule: &str| match rule.strip_suffix("/**") {
            Some(family) => entity.strip_prefix(family).is_some_and(|rest| rest.starts_with('/') || family.is_empty()),
            None => entity == rule,
        };
        let is_named = |sign: &str| self.contents.iter().filter_map(|rule| rule.strip_prefix(sign)).any(names);
        is_named("+ ") && !is_named("- ")
    }

    /// Smallest and largest value of the lines, entities with their outlines, and of the marks of events on the axis.
    pub fn values(&self, lines: &[(&str, &Outline)]) -> Option<[f64; 2]> {
        let ranges = lines.iter().filter(|(entity, _)| self.shows(entity)).filter_map(|(_, outline)| outline.range);
        let [low, high] = ranges.reduce(|[low, high], of| [f64::min(low, of[0]), f64::max(high, of[1])])?;
        let has_marks = self.shows(&MARKS_ON_AXIS.of(&["ends"]));
        Some(if has_marks { [low.min(0.0), high.max(0.0)] } else { [low, high] })
    }

    /// The corner in which the legend covers the fewest points of the lines: entities with their outlines; none at the step
    /// `opening` if that can be. The present one if no other is better.
    pub fn emptiest_corner(&self, lines: &[(&str, &Outline)], opening: Option<f64>) -> Corner2D {
        let shown = || lines.iter().filter(|(entity, of)| !of.points.is_empty() && self.shows(entity));
        // one more for events
        let height = f64::min(HEIGHT * (shown().count() + 1) as f64, 0.95);
        let points: Vec<(f64, f64)> =
            shown().flat_map(|(_, of)| of.points.iter().map(|&(step, value)| (step as f64, value))).collect();
        let ends = lines.iter().filter_map(|(_, of)| of.points.first().zip(of.points.last()));
        let ends = ends.map(|((first, _), (last, _))| [*first as f64, *last as f64]);
        let [start, end] = ends.reduce(|[low, high], of| [low.min(of[0]), high.max(of[1])]).unwrap_or_default();
        let [low, high] = self.range.or_else(|| self.values(lines)).unwrap_or_default();
        let covered = |corner: &Corner2D| {
            let (is_left, is_top) = match corner {
                Corner2D::LeftTop => (true, true),
                Corner2D::LeftBottom => (true, false),
                Corner2D::RightTop => (false, true),
                Corner2D::RightBottom => (false, false),
            };
            let is_covered = |&&(step, value): &&(f64, f64)| {
                let (across, up) = ((step - start) / (end - start), (value - low) / (high - low));
                let (x, y) = (if is_left { across } else { 1.0 - across }, if is_top { 1.0 - up } else { up });
                x <= WIDTH && (0.0..=height).contains(&y)
            };
            let is_open =
                |(step, _): &(f64, f64)| opening.is_some_and(|opening| (step - opening).abs() <= NEAR * (end - start));
            let covered = points.iter().filter(is_covered);
            let open = covered.clone().any(is_open);
            (open, covered.count())
        };
        // the first of equal ones
        let corners = [self.corner, Corner2D::RightBottom, Corner2D::RightTop, Corner2D::LeftBottom, Corner2D::LeftTop];
        corners.into_iter().min_by_key(covered).unwrap_or(self.corner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_legend_moves_to_the_corner_without_lines() {
        let plot = |corner| {
            let contents = ["+ /pairs/**", "- /pairs/a~b/gap"].map(str::to_owned).to_vec();
            Plot { path: String::new(), contents, corner, range: None }
        };
        let (mut falling, mut rising) = (Outline::default(), Outline::default());
        (0..=100).for_each(|step| falling.add(step, 100.0 - step as f64));
        (0..=100).for_each(|step| rising.add(step, step as f64));
        let lines = [("/pairs/a~b/distance", &falling), ("/pairs/a~b/gap", &rising), ("/energy", &rising)];
        assert_eq!(plot(Corner2D::LeftTop).values(&lines), Some([0.0, 100.0]));
        // from the left top to the right bottom
        assert_eq!(plot(Corner2D::RightBottom).emptiest_corner(&lines, None), Corner2D::RightTop);
        assert_eq!(plot(Corner2D::RightTop).emptiest_corner(&lines, Some(1.0)), Corner2D::RightTop);
        assert_eq!(
            plot(Corner2D::LeftTop).emptiest_corner(&[("/pairs/a~b/distance", &rising)], Some(95.0)),
            Corner2D::LeftTop
        );
        assert_eq!(plot(Corner2D::LeftBottom).emptiest_corner(&lines, None), Corner2D::LeftBottom);
        assert_eq!(plot(Corner2D::LeftTop).emptiest_corner(&[], None), Corner2D::LeftTop);
    }
}
