//! The panel of parameters is made of descriptions alone.

use super::*;
use egui_kittest::kittest::Queryable;

#[test]
fn every_plugin_shows_all_its_parameters_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    for plugin in plugins().plugins() {
        done(&mut harness, Command::AddStep { plugin: plugin.id().to_owned(), at: None });
        // Some parameters are below the end of the window, where nothing is drawn.
        harness.set_size(egui::vec2(1440.0, 4000.0));
        harness.run_steps(4);
        for param in plugin.params() {
            let found = harness.query_all_by_label_contains(&param.name).count();
            assert!(found > 0, "{}: {}", plugin.id(), param.name);
        }
        done(&mut harness, Command::Undo);
    }
}

#[test]
fn a_value_is_set_and_reset() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window();
    open(&mut harness, &model(folder.path()));
    done(&mut harness, Command::AddStep { plugin: "warp".to_owned(), at: None });
    let value = toml::Value::Float(33.0);
    let plugin = plugins().get("warp").unwrap().clone();
    let id =
        plugin.params().iter().find(|p| p.kind == simod_plugin_api::ParamKind::FLOAT).unwrap().id.to_string();
    let name = plugin.params().iter().find(|p| p.id == id.as_str()).unwrap().name.to_string();
    let given =
        |harness: &Harness<'_, App>| harness.state().window().chosen().unwrap().2.params.get(&id).cloned();
    let change = simod_session::edit::Change::SetParam { id: id.clone(), value: Some(value.clone()) };
    assert!(harness.state_mut().window_mut().change(0, change, false));
    settle(&mut harness);
    assert_eq!(given(&harness), Some(value));
    harness.get_by_label(&format!("Reset {name}")).click();
    settle(&mut harness);
    assert_eq!(given(&harness), None);
}
