//! Output of `compare --peers`: a table for programs, a table for people.

use std::fmt::Write as _;

use super::{
    limits::{areas_in, grid_text, name_in, walked_area},
    versioned,
};
use crate::{analysis::compare::peers::PeerStudy, scene::Units};

pub fn csv(study: &PeerStudy) -> String {
    versioned(study.table()).csv()
}

pub fn text(study: &PeerStudy, units: Units) -> String {
    let mut text = format!(
        "area by limit of the motion, {}, and its share of the area with the true velocity; >: a cap of the walk \
         cuts the area\n  untuned defaults; walks for each area: {}; {}",
        areas_in(units).0,
        study.question.repeats,
        grid_text(&study.question.walk, units)
    );
    let width = study.rows.iter().map(|row| row.name.len()).max().unwrap_or(0);
    for (place, (loop_name, scene)) in study.question.loops.iter().enumerate() {
        let _ = write!(
            text,
            "\n  loop of {}, latency {} samples, the {} pushes\n  {:width$}",
            loop_name,
            scene.actuator.latency,
            scene.wall_hit.push_by.name(),
            ""
        );
        for limit in &study.question.limits {
            let _ = write!(text, "  {:>14}", name_in(*limit, units));
        }
        for row in study.rows.iter().filter(|row| row.of_loop == place) {
            let _ = write!(text, "\n  {:width$}", row.name);
            for n in 0..row.boundaries.len() {
                let a = study.area(row, n);
                let share = a.share_of_true_velocity().unwrap_or_default() * 100.0;
                let digits = usize::from(share < 9.95);
                let area = walked_area(a.boundaries(), units);
                let cell = format!("{area} {share:5.digits$} %");
                let _ = write!(text, "  {cell:>14}");
            }
        }
    }
    text.push_str("\n  where each stands");
    for row in study.rows.iter().filter(|row| row.of_loop == 0) {
        let source = if row.source.is_empty() { "" } else { "; " };
        let _ = write!(text, "\n  {:width$}  {}{source}{}", row.name, row.does, row.source);
    }
    for note in &study.notes {
        let _ = write!(text, "\n  note: {note}");
    }
    text
}
