//! The graphics card, or the software that stands in for it.

use wgpu::{AdapterInfo, Device, DeviceType, Limits, Queue};

/// A device that draws. Clones are the same device.
#[derive(Clone, Debug)]
pub struct Gpu {
    pub(crate) device: Device,
    pub(crate) queue: Queue,
    name: String,
    software: bool,
}

/// The error of a machine that has nothing to draw with.
#[derive(Debug, thiserror::Error)]
#[error("no graphics adapter: {reason}\nhint: {}", NoGpu::HINT)]
pub struct NoGpu {
    reason: String,
}

impl NoGpu {
    /// Advice to the user.
    pub const HINT: &'static str = "install your graphics card's Vulkan driver, or one in software \
        (on Debian and Ubuntu: apt install mesa-vulkan-drivers libvulkan1)";
}

/// Most bytes of a buffer that are asked for: room for 64 million samples.
const BUFFER: u64 = 1 << 30;

impl Gpu {
    /// A device without a window: the fastest card, or else one in software.
    ///
    /// # Errors
    /// There is no device, or it refuses.
    pub fn headless() -> Result<Self, NoGpu> {
        pollster::block_on(Self::open())
    }

    async fn open() -> Result<Self, NoGpu> {
        let adapter = match find(false).await {
            Ok(adapter) => adapter,
            Err(reason) => find(true).await.map_err(|_| NoGpu { reason })?,
        };
        let offered = adapter.limits();
        // The limits are those that every adapter of the last decade has, with longer buffers where the
        // adapter has any.
        let required_limits = Limits {
            max_buffer_size: offered.max_buffer_size.min(BUFFER),
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size.min(BUFFER),
            ..Limits::default().or_worse_values_from(&offered)
        };
        let descriptor =
            wgpu::DeviceDescriptor { label: Some("simod-scene"), required_limits, ..Default::default() };
        let (device, queue) =
            adapter.request_device(&descriptor).await.map_err(|e| NoGpu { reason: e.to_string() })?;
        Ok(Self::from_device(device, queue, &adapter.get_info()))
    }

    /// A device that somebody else opened, as a window's. The default limits of `wgpu` suffice.
    pub fn from_device(device: Device, queue: Queue, adapter: &AdapterInfo) -> Self {
        let name = format!("{} ({})", adapter.name, adapter.backend);
        Self { device, queue, name, software: adapter.device_type == DeviceType::Cpu }
    }

    /// The adapter's name, and the interface by which it is driven.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the processor draws.
    pub fn is_software(&self) -> bool {
        self.software
    }

    /// Waits until all that was asked for is drawn.
    pub fn wait(&self) {
        // An error here is a lost device, of which the next call tells.
        let _ = self.device.poll(wgpu::PollType::wait_indefinitely());
    }
}

async fn find(force_fallback_adapter: bool) -> Result<wgpu::Adapter, String> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let options = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        force_fallback_adapter,
        ..Default::default()
    };
    instance.request_adapter(&options).await.map_err(|error| error.to_string())
}
