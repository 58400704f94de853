//! The user's settings, kept from one day to the next in a small file.

use serde::{Deserialize, Serialize};
use simod_scene::{Light, Matcap};
use simod_session::session_file::SamplingTable;
use simod_viewer::Navigation;
use std::path::{Path, PathBuf};

/// Models and sessions that are remembered.
const RECENT: usize = 10;

/// Brightness of the window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Theme {
    #[default]
    Dark,
    Light,
}

/// Light of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lighting {
    #[default]
    Lamps,
    Camera,
    Ceramic,
    Metal,
    Wax,
    Stripes,
}

impl Lighting {
    /// Light of the renderer that belongs to the setting.
    pub fn light(self) -> Light {
        match self {
            Self::Lamps => Light::Key,
            Self::Camera => Light::Head,
            Self::Ceramic => Light::Matcap(Matcap::Ceramic),
            Self::Metal => Light::Matcap(Matcap::Metal),
            Self::Wax => Light::Matcap(Matcap::Wax),
            Self::Stripes => Light::Matcap(Matcap::Stripes),
        }
    }
}

/// The user's settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", default)]
pub struct WindowSettings {
    /// Brightness of the window.
    pub theme: Theme,
    /// The name of the way to move the camera; see [`Navigation::ALL`].
    pub navigation: String,
    /// Light of the surface.
    pub light: Lighting,
    /// Whether crevices are darker.
    pub occlusion: bool,
    /// About how many samples are taken of a model that is opened.
    pub samples: u64,
    /// Models and sessions that were opened last, latest first.
    pub recent: Vec<PathBuf>,
    /// File in which the settings are kept; none in tests.
    #[serde(skip)]
    file: Option<PathBuf>,
}

impl Default for WindowSettings {
    fn default() -> Self {
        Self {
            theme: Theme::default(),
            navigation: Navigation::ALL[0].name.to_owned(),
            light: Lighting::default(),
            occlusion: true,
            samples: 150_000,
            recent: Vec::new(),
            file: None,
        }
    }
}

impl WindowSettings {
    /// Loads the user's settings. A setting that cannot be read has its first value.
    pub fn load() -> Self {
        let folders = directories::ProjectDirs::from("", "", "simod");
        let file = folders.map(|f| f.config_dir().join("viewer.toml"));
        let text = file.as_ref().and_then(|file| std::fs::read_to_string(file).ok());
        let known = text.and_then(|text| toml::from_str::<Self>(&text).ok()).unwrap_or_default();
        Self { file, ..known }
    }

    /// Writes the settings to their file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self) -> simod_model::Result<()> {
        let Some(file) = &self.file else { return Ok(()) };
        let Ok(text) = toml::to_string(self) else { return Ok(()) };
        let folder = file.parent().unwrap_or(Path::new(""));
        std::fs::create_dir_all(folder).map_err(|e| simod_model::Error::io("make the folder", folder, &e))?;
        simod_model::output::write_file(file, text.as_bytes())
    }

    /// The preset for the drags that move the camera.
    pub fn navigation(&self) -> &'static Navigation {
        Navigation::ALL.iter().find(|n| n.name == self.navigation).unwrap_or(&Navigation::ALL[0])
    }

    /// Remembers a model or session that was opened.
    pub fn remember(&mut self, path: &Path) {
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        self.recent.retain(|other| *other != path);
        self.recent.insert(0, path);
        self.recent.truncate(RECENT);
    }

    /// Forgets a model or session that cannot be opened.
    pub fn forget(&mut self, path: &Path) {
        let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        self.recent.retain(|other| *other != whole && other != path);
    }
}

/// Whether the path says itself how its model is sampled: a session, or the folder of a sampled model.
pub fn is_sampled(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "toml") || path.is_dir()
}

/// Sampling of a model that is opened, with the number of samples that `--samples` gives.
pub fn sampling(samples: Option<u64>) -> SamplingTable {
    SamplingTable { samples, ..SamplingTable::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_comes_first_and_once() {
        let mut settings = WindowSettings::default();
        for name in ["a", "b", "a"] {
            settings.remember(Path::new(name));
        }
        assert_eq!(settings.recent, [PathBuf::from("a"), PathBuf::from("b")]);
        settings.forget(Path::new("a"));
        assert_eq!(settings.recent, [PathBuf::from("b")]);
        (0..30).for_each(|i| settings.remember(Path::new(&format!("{i}"))));
        assert_eq!(settings.recent.len(), RECENT);
    }

    #[test]
    fn what_is_missing_in_the_file_is_as_at_first() {
        let some: WindowSettings = toml::from_str("theme = \"light\"").unwrap();
        assert_eq!(some, WindowSettings { theme: Theme::Light, ..WindowSettings::default() });
    }
}
