//! Joint errors of the parameters that `identify` finds.

use host_sim::{
    analysis::identify::{Drive, identify},
    scene::NamedScene,
};
use rayon::prelude::*;

use crate::{
    figure::figure,
    identify_accuracy::{GAIN_N_PER_V, Made, PAPER, PLAIN, RATE_HZ, made, options},
};

/// Identifies one device from many records. The errors of mass, damping, spring and latency are correlated as the first
/// record states.
#[test]
fn the_numbers_of_a_device_err_together_as_stated() {
    const RECORDS: u64 = 120;
    let found: Vec<_> = (0..RECORDS)
        .into_par_iter()
        .map(|seed| {
            let made_as = Made { seed, ..PLAIN };
            let mut options = options(&made_as);
            options.fit_latency = true;
            identify(&[made(&made_as)], &options).unwrap()
        })
        .collect();
    let truth = [
        PAPER.mass_kg,
        PAPER.damping_n_s_per_m,
        PAPER.stiffness_n_per_m,
        PAPER.rest_position_m,
        GAIN_N_PER_V,
        PLAIN.latency / RATE_HZ,
    ];
    let errors: Vec<[f64; 6]> = found
        .iter()
        .map(|found| {
            let spring = found.spring.unwrap();
            let values = [
                found.mass_kg,
                found.damping_n_s_per_m,
                spring.stiffness_n_per_m,
                spring.rest_position_m,
                found.gain_n_per_v,
                found.latency_s,
            ];
            std::array::from_fn(|n| values[n].value - truth[n])
        })
        .collect();
    let joint = found[0].joint;
    assert_eq!(joint.deviations[4], 0.0, "the gain was given");
    let product = |a: usize, b: usize| {
        errors.iter().map(|error| error[a] * error[b]).sum::<f64>() / RECORDS as f64
    };
    let (mut strongest, mut farthest) = (0f64, 0f64);
    for (a, b) in
        (0..6).flat_map(|b| (0..b).map(move |a| (a, b))).filter(|(a, b)| *a != 4 && *b != 4)
    {
        let stated = joint.correlations[a][b];
        let seen = product(a, b) / (product(a, a) * product(b, b)).sqrt();
        // Four standard errors of a correlation.
        let allowed = 4.0 * (1.0 - stated * stated) / (RECORDS as f64).sqrt() + 0.02;
        println!("{a} {b}: stated {stated:.3}, seen {seen:.3}");
        assert!((seen - stated).abs() < allowed, "{a} {b}: stated {stated:.3}, seen {seen:.3}");
        assert_eq!(stated, joint.correlations[b][a]);
        strongest = strongest.max(stated.abs());
        farthest = farthest.max((seen - stated).abs());
    }
    assert!(strongest > 0.5, "some of them do err together: {strongest}");
    figure("host/identify/correlation_off", farthest);
    for place in [0, 1, 2, 3, 5] {
        let ratio = product(place, place).sqrt() / joint.deviations[place];
        println!("{place}: {ratio:.2} of the stated deviation");
        assert!((0.6..1.2).contains(&ratio), "{place}: {ratio}");
    }
    // A scene with the results can be read. Devices drawn from this scene have these correlated errors.
    let scene = NamedScene::load("paper-1um").unwrap();
    let uncertainty = joint.uncertainty(None, &scene.scene, Drive::default());
    assert!((uncertainty.latency / (joint.deviations[5] * RATE_HZ) - 1.0).abs() < 1e-12);
    let mut drawn = scene.scene;
    drawn.uncertainty = Some(uncertainty);
    drawn.check().unwrap();
    drawn.drawn(1, 0).unwrap();
}
