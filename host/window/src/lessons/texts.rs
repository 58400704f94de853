//! The lessons.

use super::doing::{
    add, change, has_region, in_hand, is_region_moved, is_selected, look_from_front, make_region,
    move_in_hand, move_region, number, paint, place_joints, select_between, step, strokes, take_highest,
    take_joint, turn_joint,
};
use super::{Exercise, Lesson};
use simod_generate::Shape;
use simod_session::edit::Change;
use simod_session::step::Role;
use simod_viewer::command::CameraMove;
use simod_viewer::{Command, ComparedVersion, Overlay};

const WARP: &str = "warp";
const LAPLACIAN: &str = "laplacian";
const LATTICE: &str = "lattice";
const SKINNING: &str = "skinning";
const PAINT: &str = "displacement-paint";

/// The lessons, in their order.
pub const ALL: &[Lesson] = &[
    Lesson {
        title: "Twist a Bar",
        about: "looking around, steps and their numbers, undo",
        shape: Shape::Bar,
        file: "lesson-bar.ply",
        parts: &[
            Exercise {
                text: "Look around: drag with the left button beside the bar. The wheel zooms, the right button \
                       moves the picture.",
                done: |w, began| w.state().camera() != began,
                run: |_, c| c.apply(Command::Camera(CameraMove::Orbit { yaw: 0.7, pitch: 0.1 })),
            },
            Exercise {
                text: "Whatever deforms the model is a step. Choose + Add Step at the right, and there Warp.",
                done: |w, _| step(w, WARP).is_some(),
                run: |w, c| add(w, c, WARP),
            },
            Exercise {
                text: "The bar is twisted by 90 degrees. Drag the number at Angle, or type another one: at \
                       least 180.",
                done: |w, _| number(w, WARP, "angle").is_some_and(|angle| angle.abs() >= 180.0),
                run: |w, c| {
                    change(w, c, WARP, Change::SetParam { id: "angle".into(), value: Some(240.0.into()) })
                },
            },
            Exercise {
                text: "Amount, above it, blends any step with what it begins with. Drag it to about a half.",
                done: |w, _| step(w, WARP).is_some_and(|(.., d)| d.amount < 0.9),
                run: |w, c| change(w, c, WARP, Change::SetAmount(0.5)),
            },
            Exercise {
                text: "Nothing is ever lost: Ctrl+Z takes a change back, Ctrl+Shift+Z does it again. Take one \
                       back.",
                done: |w, _| w.state().can_redo().is_some(),
                run: |_, c| c.apply(Command::Undo),
            },
        ],
        ends: "Save Session (Ctrl+S) keeps the steps in a small file; Write Deformed Model (Ctrl+E) streams the whole \
               model through them, however large it is.",
    },
    Lesson {
        title: "Bend a Cactus by a Handle",
        about: "selecting, fixed regions and handles, a surface that bends in between",
        shape: Shape::Cactus,
        file: "lesson-cactus.ply",
        parts: &[
            Exercise {
                text: "Look at it from its front: press 1, then Home to see all of it.",
                done: |w, _| {
                    let camera = w.state().camera();
                    camera.yaw.abs() < 0.02 && camera.pitch.abs() < 0.02
                },
                run: look_from_front,
            },
            Exercise {
                text: "Add a step of Laplacian surface editing: it bends a surface like a skin.",
                done: |w, _| step(w, LAPLACIAN).is_some(),
                run: |w, c| add(w, c, LAPLACIAN),
            },
            Exercise {
                text: "Some part has to stay. Take the box (B), choose Through above the picture, and draw a box \
                       round the foot.",
                done: |w, _| is_selected(w),
                run: |w, c| select_between(w, c, [0.0, 0.12]),
            },
            Exercise {
                text: "Choose Make Fixed at the right (Shift+F): what was selected is held.",
                done: |w, _| has_region(w, LAPLACIAN, Role::Fixed),
                run: |w, c| make_region(w, c, LAPLACIAN, Role::Fixed),
            },
            Exercise {
                text: "Now the part that you will move: take the box (B) again, and draw it round the top of the \
                       stem.",
                done: |w, _| is_selected(w) || has_region(w, LAPLACIAN, Role::Handle),
                run: |w, c| select_between(w, c, [0.88, 1.0]),
            },
            Exercise {
                text: "Choose Make Handle (Shift+H).",
                done: |w, _| has_region(w, LAPLACIAN, Role::Handle),
                run: |w, c| make_region(w, c, LAPLACIAN, Role::Handle),
            },
            Exercise {
                text: "Drag its arrows. R takes the rings that turn it, and the surface follows.",
                done: |w, _| is_region_moved(w, LAPLACIAN),
                run: |w, c| move_region(w, c, LAPLACIAN),
            },
        ],
        ends: "Radial basis functions, Smooth handles and Elastic body take the same regions: add one, and see what \
               differs.",
    },
    Lesson {
        title: "Shape an Amphora in a Lattice",
        about: "handles that a step brings along, several at a time, seeing what is stretched",
        shape: Shape::Amphora,
        file: "lesson-amphora.ply",
        parts: &[
            Exercise {
                text: "Add a step of the Lattice: points about the model, by which the space inside is bent.",
                done: |w, _| step(w, LATTICE).is_some(),
                run: |w, c| add(w, c, LATTICE),
            },
            Exercise {
                text: "Click one of the points near the top.",
                done: |w, _| in_hand(w, LATTICE) >= 1,
                run: |w, c| take_highest(w, c, LATTICE, 1),
            },
            Exercise {
                text: "Hold Shift, and click another one besides: both are in the hand.",
                done: |w, _| in_hand(w, LATTICE) >= 2,
                run: |w, c| take_highest(w, c, LATTICE, 4),
            },
            Exercise {
                text: "Press G, move the pointer, and click where they shall stay; or drag the arrows.",
                done: |w, _| step(w, LATTICE).is_some_and(|(.., d)| !d.handles.is_empty()),
                run: |w, c| move_in_hand(w, c, LATTICE),
            },
            Exercise {
                text: "See what was stretched: choose Stretch in the menu Overlay. The scale is below the picture.",
                done: |w, _| w.state().overlay() == Overlay::Stretch,
                run: |_, c| c.apply(Command::Show(Overlay::Stretch)),
            },
        ],
        ends: "Falloff, above the picture, has points around go along. The box (B) takes many at once, where Handles is \
               chosen for it.",
    },
    Lesson {
        title: "Pose with Bones",
        about: "a skeleton of your own, joints that turn what hangs on them",
        shape: Shape::Cactus,
        file: "lesson-cactus.ply",
        parts: &[
            Exercise {
                text: "Look at it from its front: press 1, then Home to see all of it.",
                done: |w, _| {
                    let camera = w.state().camera();
                    camera.yaw.abs() < 0.02 && camera.pitch.abs() < 0.02
                },
                run: look_from_front,
            },
            Exercise {
                text: "Add a step of Skinning: bones carry what is around them.",
                done: |w, _| step(w, SKINNING).is_some(),
                run: |w, c| add(w, c, SKINNING),
            },
            Exercise {
                text: "Place Joints (J) is in the hand. Click the foot of the stem, its middle, and its top: \
                       they lie within it, and each hangs on the one before.",
                done: |w, _| step(w, SKINNING).is_some_and(|(.., d)| d.joints.len() >= 3),
                run: |w, c| place_joints(w, c, SKINNING),
            },
            Exercise {
                text: "Take Rotate (R), and click the joint in the middle.",
                done: |w, _| in_hand(w, SKINNING) >= 1 && w.tools.tool == crate::tools::Tool::Rotate,
                run: |w, c| take_joint(w, c, SKINNING, 1),
            },
            Exercise {
                text: "Drag one of the rings: all above the joint turns with it.",
                done: |w, _| step(w, SKINNING).is_some_and(|(.., d)| !d.handles.is_empty()),
                run: |w, c| turn_joint(w, c, SKINNING, 1),
            },
        ],
        ends: "Alt+G takes the motion of a joint back. More joints branch off where one is clicked before they are placed.",
    },
    Lesson {
        title: "Paint and Compare",
        about: "brush strokes, two versions side by side, the vertices themselves",
        shape: Shape::BumpySphere,
        file: "lesson-sphere.ply",
        parts: &[
            Exercise {
                text: "Add a step of Displacement painting.",
                done: |w, _| step(w, PAINT).is_some(),
                run: |w, c| add(w, c, PAINT),
            },
            Exercise {
                text: "The brush is in the hand: paint a stroke over the sphere. [ and ] change its size.",
                done: |w, _| strokes(w, PAINT) >= 1,
                run: |w, c| paint(w, c, PAINT, 0.42),
            },
            Exercise {
                text: "Press P to pin this version, to compare with it later.",
                done: |w, _| w.state().pinned().is_some(),
                run: |_, c| c.apply(Command::Pin),
            },
            Exercise {
                text: "Paint another stroke, with Ctrl held if it shall dig in.",
                done: |w, _| strokes(w, PAINT) >= 2,
                run: |w, c| paint(w, c, PAINT, 0.58),
            },
            Exercise {
                text: "Press V to see both versions side by side; the key X, held, shows the pinned one in place.",
                done: |w, _| w.looks.side_by_side,
                run: |_, c| c.then(|w| w.looks.side_by_side = true),
            },
            Exercise {
                text: "Where do they differ? Choose Difference from the Pinned Version in the menu Overlay.",
                done: |w, _| {
                    w.state().overlay() == Overlay::Difference
                        && w.state().scene_of(ComparedVersion::Pinned).is_some()
                },
                run: |_, c| c.apply(Command::Show(Overlay::Difference)),
            },
        ],
        ends: "I shows the vertices of the file itself in place of samples, carried over as writing the model would.",
    },
];
