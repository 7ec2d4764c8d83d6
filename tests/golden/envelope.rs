/// Predicted-stable walls, from a sweep.
pub static GOLDEN: Envelope<'static> = Envelope {
    boundaries: &[
        Boundary {
            key: Key { device: "paper-1um", estimator: "butterworth", cutoff_hz: 1500.0, latency_samples: 10.0, period_samples: 10.0 },
            points: &[
                Point { damping_n_s_per_m: 10.0, stiffness_low_n_per_m: 0.0, stiffness_high_n_per_m: 4000.0 },
                Point { damping_n_s_per_m: 20.0, stiffness_low_n_per_m: 2000.0, stiffness_high_n_per_m: 12000.0 },
            ],
        },
    ],
};
