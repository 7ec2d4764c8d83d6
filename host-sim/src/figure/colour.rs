//! Colours: one ordered scale for the cutoffs, one accent for the ideal one.

use super::drawing::Ink;
use super::raster::byte;

pub(super) const PAPER: Ink = Ink::new(255, 255, 255);
pub(super) const TEXT: Ink = Ink::new(26, 26, 26);
pub(super) const QUIET: Ink = Ink::new(90, 90, 90);
pub(super) const GRID: Ink = Ink::new(224, 224, 224);
pub(super) const FRAME: Ink = Ink::new(60, 60, 60);
/// Marks the ideal cutoff. Vermilion of Okabe and Ito: distinct from the scale under every common
/// colour vision deficiency.
pub(super) const ACCENT: Ink = Ink::new(213, 94, 0);
/// Data that has no cutoff of its own. Blue of Okabe and Ito.
pub(super) const DATA: Ink = Ink::new(0, 90, 150);

/// Viridis of matplotlib at 0, 1/8, .. 1 (CC0): lightness rises evenly, so the order survives print
/// in grey.
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 45, 123],
    [59, 82, 139],
    [44, 114, 142],
    [33, 145, 140],
    [40, 174, 128],
    [94, 201, 98],
    [173, 220, 48],
    [253, 231, 37],
];
/// The yellow end is too light on paper.
const LAST_SHARE: f64 = 0.88;

/// The colour of curve `index` of `count`.
pub(super) fn ordered(index: usize, count: usize) -> Ink {
    let share = if count > 1 { LAST_SHARE * index as f64 / (count - 1) as f64 } else { 0.3 };
    let mut position = share * (VIRIDIS.len() - 1) as f64;
    let mut pair = [VIRIDIS[0], VIRIDIS[1]];
    for stops in VIRIDIS.windows(2) {
        pair = [stops[0], stops[1]];
        if position <= 1.0 {
            break;
        }
        position -= 1.0;
    }
    let mix = |channel: usize| {
        let [from, to] = pair.map(|stop| f64::from(stop[channel]));
        byte(from + (to - from) * position)
    };
    Ink::new(mix(0), mix(1), mix(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_grows_lighter_and_repeats_no_colour() {
        let luma = |ink: Ink| {
            let [r, g, b] = ink.rgb.map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        for count in [2, 12, 30] {
            let colours: Vec<Ink> = (0..count).map(|index| ordered(index, count)).collect();
            assert!(colours.windows(2).all(|pair| luma(pair[0]) < luma(pair[1])));
        }
    }
}
