//! Lessons, done by the window, and by hand.

use super::picture::{can_draw, drawn, drawn_window};
use super::*;
use egui_kittest::kittest::Queryable;
use simod_viewer::command::CameraMove;
use simod_window::lessons::{self, ALL};

fn at(harness: &Harness<'_, App>) -> (usize, usize) {
    let running = harness.state().window().lesson.as_ref().unwrap();
    (running.lesson, running.part)
}

#[test]
fn each_lesson_can_be_done_by_the_window() {
    let draws = can_draw();
    let mut harness = if draws { drawn_window() } else { window() };
    harness.run_steps(3);
    if draws {
        drawn(&mut harness, "welcome");
    }
    assert_eq!(ALL.len(), 5);
    harness.get_by_label(&format!("1. {}", ALL[0].title)).click();
    settle(&mut harness);
    for (lesson, told) in ALL.iter().enumerate() {
        settle(&mut harness);
        // A part that is done from the beginning, as the camera may be, is passed already.
        for part in at(&harness).1..told.parts.len() {
            assert_eq!(at(&harness), (lesson, part), "{}", told.parts[part].text);
            assert!(harness.query_by_label(told.parts[part].text).is_some());
            harness.get_by_label("Do It for Me").click();
            harness.run_steps(2);
            settle(&mut harness);
        }
        let errors: Vec<&str> = harness.state().window().toasts.texts().collect();
        assert!(errors.is_empty(), "{}: {errors:?}", told.title);
        assert_eq!(at(&harness), (lesson, told.parts.len()));
        if draws {
            harness.run_steps(6);
            drawn(&mut harness, &format!("lesson-{}", lesson + 1));
        }
        assert!(harness.query_by_label(told.ends).is_some());
        let scene = harness.state().window().state().scene().unwrap().clone();
        assert!(scene.positions.iter().zip(&scene.sampled.samples.positions).any(|(a, b)| a != b));
        if lesson + 1 < ALL.len() {
            harness.get_by_label("Next Lesson").click();
            settle(&mut harness);
            // The edit so far is in no file; it was only an exercise.
            harness.get_by_label("Discard").click();
            settle(&mut harness);
        }
    }
    assert!(harness.query_by_label("Next Lesson").is_none());
    harness.get_by_label("End Lesson").click();
    harness.run_steps(2);
    assert!(harness.state().window().lesson.is_none());
}

#[test]
fn a_lesson_goes_on_by_what_the_user_does() {
    let mut harness = window();
    harness.state_mut().window_mut().draw(|_, commands| lessons::begin(commands, 0));
    settle(&mut harness);
    assert_eq!(at(&harness), (0, 0));
    done(&mut harness, Command::Camera(CameraMove::Orbit { yaw: 0.2, pitch: 0.0 }));
    assert_eq!(at(&harness), (0, 1));
    done(&mut harness, Command::AddStep { plugin: "lattice".to_owned(), at: None });
    assert_eq!(at(&harness), (0, 1), "another step is not what was asked for");
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    assert_eq!(at(&harness), (0, 2));
    // Another model: the lesson waits for its own.
    let folder = tempfile::tempdir().unwrap();
    let path = model(folder.path());
    harness.state_mut().window_mut().open_now(path, SamplingTable::default(), false);
    settle(&mut harness);
    assert!(harness.query_by_label("Its model is not open.").is_some());
    harness.get_by_label("Open It").click();
    settle(&mut harness);
    assert_eq!(at(&harness), (0, 0), "it begins anew");
    assert!(harness.query_by_label(ALL[0].parts[0].text).is_some());
}
