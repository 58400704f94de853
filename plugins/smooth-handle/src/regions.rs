//! The samples of regions.

use simod_plugin_api::{PluginError, PluginResult, PrepareInput, Role};

/// Weight from which on a sample is in a region, and not on its soft rim.
const INSIDE: f32 = 0.999;

/// The fixed regions as one, and each handle.
pub struct MergedRegions {
    /// Fixed regions as one, if there are any, and then the handles in their order.
    pub parts: Vec<MergedRegion>,
    /// Whether the first part is that of the fixed regions.
    pub has_fixed: bool,
}

/// One handle, or all fixed regions.
pub struct MergedRegion {
    /// Samples in the region, each in one part alone.
    pub core: Vec<u32>,
    /// One weight for each sample, 0 to 1.
    pub weights: Vec<f32>,
}

impl MergedRegions {
    /// Merged regions of a preparation. A sample in several regions belongs to the first fixed one, or else
    /// to the first handle.
    pub fn gather(input: &PrepareInput<'_>) -> PluginResult<Self> {
        let count = input.samples.positions().len();
        let regions = input.regions();
        if let Some(i) = regions.iter().position(|r| r.weights().len() != count) {
            return Err(PluginError::internal(format!("region {} has not one weight per sample", i + 1)));
        }
        let handles = regions.iter().filter(|r| r.role == Role::HANDLE);
        let fixed: Vec<_> = regions.iter().filter(|r| r.role == Role::FIXED).collect();
        let has_fixed = !fixed.is_empty();
        let mut weights: Vec<Vec<f32>> = Vec::new();
        if has_fixed {
            let largest = |i: usize| fixed.iter().map(|r| r.weights()[i]).fold(0.0, f32::max);
            weights.push((0..count).map(largest).collect());
        }
        weights.extend(handles.map(|r| r.weights().to_vec()));
        if weights.len() == usize::from(has_fixed) {
            return Err(PluginError::input("there is no handle region")
                .hint("add a region with role = \"handle\" and a move"));
        }
        let owner = |i: usize| weights.iter().position(|w| w[i] >= INSIDE);
        let mut cores = vec![Vec::new(); weights.len()];
        (0..count).for_each(|i| owner(i).into_iter().for_each(|r| cores[r].push(i as u32)));
        if let Some(r) = cores.iter().position(Vec::is_empty) {
            let what = match r.checked_sub(usize::from(has_fixed)) {
                Some(handle) => format!("handle {}", handle + 1),
                None => "what is fixed".to_owned(),
            };
            return Err(PluginError::input(format!("{what} holds no sample of its own"))
                .hint("enlarge or move its shapes, take more samples, or let it overlap others less"));
        }
        let parts =
            cores.into_iter().zip(weights).map(|(core, weights)| MergedRegion { core, weights }).collect();
        Ok(Self { parts, has_fixed })
    }
}
