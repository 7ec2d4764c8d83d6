/// A finger at the handle: a spring and a damper from the handle to a target. The finger's force acts at the same point
/// as the motor's force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finger {
    pub target_m: f64,
    pub stiffness_n_per_m: f64,
    pub damping_n_s_per_m: f64,
    pub limit_n: f64,
}

impl Finger {
    pub(crate) fn force_n(&self, position_m: f64, speed_m_per_s: f64) -> f64 {
        let spring_n = self.stiffness_n_per_m * (self.target_m - position_m);
        let force_n = spring_n - self.damping_n_s_per_m * speed_m_per_s;
        force_n.clamp(-self.limit_n, self.limit_n)
    }
}
