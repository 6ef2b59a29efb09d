//! The worlds W0 to W5: `docs/design/identification.md` describes W0 to W4, [`PlantConfig::as_measured`] W5.

use serde::{Deserialize, Serialize};

use crate::plant::PlantConfig;

/// A kind of world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum World {
    /// Compliance, first and second encoder harmonics, white joint noise.
    W0,
    /// W0 with independently measured base and tool frames that are off.
    W1,
    /// All non-geometric effects three to four times larger.
    W2,
    /// W0 with harmonics 3 to 8, link bending and base tilt.
    W3,
    /// Out of any model's class: smooth random joint functions, cross-joint
    /// terms, ripple, nonlinear compliance, hysteresis, bending, tilt.
    W4,
    /// W4 with 5 % bad contacts of 3 to 6 mm.
    #[serde(rename = "W4 bad")]
    W4Bad,
    /// As measured: sizes from real arms and published figures
    /// ([`PlantConfig::as_measured`]).
    W5,
    /// W5 with a printed socket in place of a nest of steel.
    #[serde(rename = "W5s")]
    W5s,
}

impl World {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 8] = [
        Self::W0,
        Self::W1,
        Self::W2,
        Self::W3,
        Self::W4,
        Self::W4Bad,
        Self::W5,
        Self::W5s,
    ];

    /// Name in tables and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::W0 => "W0",
            Self::W1 => "W1",
            Self::W2 => "W2",
            Self::W3 => "W3",
            Self::W4 => "W4",
            Self::W4Bad => "W4-bad",
            Self::W5 => "W5",
            Self::W5s => "W5s",
        }
    }

    /// What it is, in a few words.
    pub const fn about(self) -> &'static str {
        match self {
            Self::W0 => "compliance, 1st and 2nd harmonics, white joint noise",
            Self::W1 => "the same, measured base and tool frames off",
            Self::W2 => "non-geometric effects three to four times larger",
            Self::W3 => "harmonics 3-8, link bending, base tilt",
            Self::W4 => "out of every model's class",
            Self::W4Bad => "the same, 5 % bad contacts of 3-6 mm",
            Self::W5 => "as measured on real arms",
            Self::W5s => "the same, with a printed socket as its nest",
        }
    }

    /// The preset of the plant that is a robot of this world.
    pub fn plant(self) -> PlantConfig {
        match self {
            Self::W0 => PlantConfig::world(0),
            Self::W1 => PlantConfig::world(1),
            Self::W2 => PlantConfig::world(2),
            Self::W3 => PlantConfig::world(3),
            Self::W4 | Self::W4Bad => PlantConfig::world(4),
            Self::W5 => PlantConfig::as_measured(),
            Self::W5s => PlantConfig::as_measured_socket(),
        }
    }

    /// Share of the contacts that are 3 to 6 mm off.
    pub const fn bad_contacts(self) -> f64 {
        match self {
            Self::W4Bad => 0.05,
            _ => 0.0,
        }
    }
}

impl std::fmt::Display for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// A name that no world has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no world `{name}`: use one of {}", World::ALL.map(World::name).join(", "))]
pub struct UnknownWorld {
    /// As given.
    pub name: String,
}

impl std::str::FromStr for World {
    type Err = UnknownWorld;

    fn from_str(name: &str) -> Result<Self, UnknownWorld> {
        Self::ALL
            .into_iter()
            .find(|w| w.name().eq_ignore_ascii_case(name))
            .ok_or_else(|| UnknownWorld { name: name.to_owned() })
    }
}
