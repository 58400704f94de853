//! Presets for the drags that move the camera, as data.

/// A button of the pointer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "they say it")]
pub enum Button {
    Left,
    Middle,
    Right,
}

/// Keys that are held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[expect(missing_docs, reason = "they say it")]
pub struct Modifiers {
    pub shift: bool,
    pub control: bool,
    pub alt: bool,
}

/// Move of the camera while the pointer is dragged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "they say it")]
pub enum Drag {
    Orbit,
    Pan,
    Zoom,
}

/// A preset: the drags by which each button moves the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Navigation {
    /// The name that the user reads.
    pub name: &'static str,
    /// Whether a tool that moves the selection begins as soon as it is taken, without a click.
    pub begins_at_once: bool,
    bindings: [(Button, Modifiers, Drag); 3],
}

const NONE: Modifiers = Modifiers { shift: false, control: false, alt: false };
const SHIFT: Modifiers = Modifiers { shift: true, ..NONE };
const CONTROL: Modifiers = Modifiers { control: true, ..NONE };
const ALT: Modifiers = Modifiers { alt: true, ..NONE };

impl Navigation {
    /// The presets that there are.
    pub const ALL: [Self; 2] = [
        Self {
            name: "Blender-like",
            begins_at_once: true,
            bindings: [
                (Button::Middle, NONE, Drag::Orbit),
                (Button::Middle, SHIFT, Drag::Pan),
                (Button::Middle, CONTROL, Drag::Zoom),
            ],
        },
        Self {
            name: "Maya-like",
            begins_at_once: false,
            bindings: [
                (Button::Left, ALT, Drag::Orbit),
                (Button::Middle, ALT, Drag::Pan),
                (Button::Right, ALT, Drag::Zoom),
            ],
        },
    ];

    /// Drags that move the camera: the button, the keys that are held, and the camera's move.
    pub fn bindings(&self) -> &[(Button, Modifiers, Drag)] {
        &self.bindings
    }

    /// Camera's move by a drag with this button and these keys, if the preset has one.
    pub fn drag(&self, button: Button, modifiers: Modifiers) -> Option<Drag> {
        self.bindings.iter().find(|b| (b.0, b.1) == (button, modifiers)).map(|b| b.2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_does_everything_and_leaves_the_plain_left_button_to_tools() {
        for navigation in Navigation::ALL {
            let all = [NONE, SHIFT, CONTROL, ALT];
            let buttons = [Button::Left, Button::Middle, Button::Right];
            let found: Vec<Drag> =
                buttons.iter().flat_map(|b| all.iter().filter_map(|m| navigation.drag(*b, *m))).collect();
            for drag in [Drag::Orbit, Drag::Pan, Drag::Zoom] {
                assert_eq!(found.iter().filter(|f| **f == drag).count(), 1, "{}: {drag:?}", navigation.name);
            }
            assert_eq!(navigation.drag(Button::Left, NONE), None);
        }
    }
}
