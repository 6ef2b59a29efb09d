//! Lists of seeds as files have them: runs of consecutive numbers, so that a million seeds take one
//! line.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// As `[[first, count], ...]`.
pub(super) fn serialize<S: Serializer>(seeds: &[u64], serializer: S) -> Result<S::Ok, S::Error> {
    let mut runs: Vec<(u64, u64)> = Vec::new();
    for &seed in seeds {
        match runs.last_mut() {
            Some((first, count)) if first.checked_add(*count) == Some(seed) => *count += 1,
            _ => runs.push((seed, 1)),
        }
    }
    runs.serialize(serializer)
}

/// From `[[first, count], ...]`.
pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u64>, D::Error> {
    /// More seeds than any study has: a damaged file must not fill the memory.
    const MOST: u64 = 100_000_000;
    let runs = Vec::<(u64, u64)>::deserialize(deserializer)?;
    let mut seeds = Vec::new();
    for (first, count) in runs {
        let end = first.checked_add(count).filter(|_| seeds.len() as u64 + count <= MOST);
        seeds.extend(first..end.ok_or_else(|| serde::de::Error::custom("too many seeds"))?);
    }
    Ok(seeds)
}
