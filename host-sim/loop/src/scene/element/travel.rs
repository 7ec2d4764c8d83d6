//! Travel limits: stops at both ends of the device's travel.
//!
//! `stop = "spring"`; d is the depth of the device beyond the end:
//! ```text
//! F = max(0, stiffness d + damping d')   against the motion, while d > 0; a stop never pulls
//! ```
//! Let a device of mass m, without other bodies, arrive with speed v. A force of at most F presses the device on the
//! stop. By conservation of energy, the depth of the device is `d <= F/k + sqrt((F/k)^2 + m v^2 / k)`.
//!
//! `stop = "rigid"`: the device never passes the end. It turns back with `restitution` times its speed. After a bounce
//! slower than [`REST_SPEED_M_PER_S`], the device rests on the stop until a force moves the device away.
//!
//! Sources: the standard coefficient of restitution, and a Kelvin-Voigt contact. The contact force is limited to values
//! from 0 on, because the damper would pull when the device leaves.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;
use crate::scene::{Device, ranges};

/// Speed after a bounce below which the device stays at a rigid stop, in m/s.
pub const REST_SPEED_M_PER_S: f64 = 1e-6;

/// The limits of the device's travel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "stop", rename_all = "lowercase", deny_unknown_fields)]
pub enum Travel {
    /// Both ends are springs with dampers.
    Spring {
        /// Lower end, below the start of a hit.
        low_m: f64,
        /// Upper end, above the start of a hit.
        high_m: f64,
        /// Stiffness of both stops.
        stiffness_n_per_m: f64,
        /// Damping of both stops.
        damping_n_s_per_m: f64,
    },
    /// Both ends are rigid. Below 1e-6 m/s the device does not bounce.
    Rigid {
        /// Lower end, below the start of a hit.
        low_m: f64,
        /// Upper end, above the start of a hit.
        high_m: f64,
        /// Ratio of the speed after a bounce to the speed before it.
        restitution: f64,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Low,
    High,
}

impl End {
    /// Sign of the direction that points out of the travel at this end.
    #[inline]
    pub fn outward(self) -> f64 {
        match self {
            Self::Low => -1.0,
            Self::High => 1.0,
        }
    }
}

impl Travel {
    #[inline]
    pub fn end_m(&self, end: End) -> f64 {
        let (Self::Spring { low_m, high_m, .. } | Self::Rigid { low_m, high_m, .. }) = *self;
        match end {
            End::Low => low_m,
            End::High => high_m,
        }
    }

    /// Distance of a position beyond an end, in m. It is negative inside the travel.
    #[inline]
    pub fn depth_m(&self, end: End, position_m: f64) -> f64 {
        (position_m - self.end_m(end)) * end.outward()
    }

    /// Inward force of a stop's spring and damper, in N. It is 0 for rigid stops.
    #[inline]
    pub fn push_n(&self, end: End, position_m: f64, speed_m_per_s: f64) -> f64 {
        match *self {
            Self::Rigid { .. } => 0.0,
            Self::Spring { stiffness_n_per_m, damping_n_s_per_m, .. } => {
                stiffness_n_per_m * self.depth_m(end, position_m)
                    + damping_n_s_per_m * speed_m_per_s * end.outward()
            }
        }
    }

    pub fn check(&self, device: &Device) -> Result<(), String> {
        let keys = Checker("travel");
        let (low_m, high_m) = (self.end_m(End::Low), self.end_m(End::High));
        keys.within("high_m", high_m, ranges::POSITION_M)?;
        keys.within("low_m", low_m, *ranges::POSITION_M.start()..=high_m)?;
        let start = "device.start_position_m";
        crate::range::within(start, device.start_position_m, low_m..=high_m)?;
        match *self {
            Self::Rigid { restitution, .. } => keys.within("restitution", restitution, 0.0..=0.99),
            Self::Spring { stiffness_n_per_m, damping_n_s_per_m, .. } => {
                keys.within("stiffness_n_per_m", stiffness_n_per_m, 1.0..=1e9)?;
                keys.within("damping_n_s_per_m", damping_n_s_per_m, ranges::DAMPING_N_S_PER_M)
            }
        }
    }
}
