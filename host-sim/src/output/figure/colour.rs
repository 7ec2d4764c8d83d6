//! The colours of figures: an ordered scale for the cutoffs, and an accent colour for the ideal cutoff.

use plotters::prelude::*;

pub(super) const TEXT: RGBColor = RGBColor(26, 26, 26);
pub(super) const QUIET: RGBColor = RGBColor(90, 90, 90);
pub(super) const GRID: RGBColor = RGBColor(224, 224, 224);
pub(super) const FRAME: RGBColor = RGBColor(60, 60, 60);
/// Vermilion of Okabe and Ito, for the ideal cutoff. With every common colour vision deficiency, a reader can
/// distinguish this colour from the scale.
pub(super) const ACCENT: RGBColor = RGBColor(213, 94, 0);
/// Colour of data that does not belong to a cutoff. It is the blue of Okabe and Ito, darkened.
pub(super) const DATA: RGBColor = RGBColor(0, 90, 150);

/// The part of viridis that is used. The yellow end is too light on paper.
const LAST_SHARE: f64 = 0.88;
const LONE_SHARE: f64 = 0.3;

/// The colour in viridis of curve `index` of `count`. Lightness increases evenly, so a grey print shows the order.
pub(super) fn ordered(index: usize, count: usize) -> RGBColor {
    let share = if count > 1 { LAST_SHARE * index as f64 / (count - 1) as f64 } else { LONE_SHARE };
    ViridisRGB.get_color(share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_grows_lighter_and_repeats_no_colour() {
        let luma = |RGBColor(red, green, blue): RGBColor| {
            0.2126 * f64::from(red) + 0.7152 * f64::from(green) + 0.0722 * f64::from(blue)
        };
        for count in [2, 12, 30] {
            let colours: Vec<RGBColor> = (0..count).map(|index| ordered(index, count)).collect();
            assert!(colours.windows(2).all(|pair| luma(pair[0]) < luma(pair[1])));
        }
    }
}
