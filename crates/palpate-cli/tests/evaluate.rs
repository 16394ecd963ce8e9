//! `palpate evaluate`: its results for programs, interruption and continuation, and bad input.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::process::Command;

use common::{Scene, holds, json, names, npy, printed, refuse, stderr, stdout, succeed};
use serde_json::Value;

/// Quick methods, one of each kind.
const QUICK: &str = "map,ekf,knn,uniform,zero";

/// `palpate evaluate` of some logs into `out/e` with quick methods.
fn evaluate(scene: &Scene, logs: &[&str], more: &[&str]) -> Command {
    let mut command = scene.command("evaluate", logs);
    command.args(["--spacing-m", "0.03"]);
    for (flag, usual) in [("-o", &*scene.text("out/e")), ("--methods", QUICK), ("--replays", "3")] {
        if !more.contains(&flag) {
            command.args([flag, usual]);
        }
    }
    command.args(more);
    command
}

/// The arm and three touches.
fn three() -> Scene {
    let scene = Scene::new();
    scene.touch("log/seq_2", 50, 0.3);
    scene
}

/// Evaluates what must be refused, and leaves nothing.
#[track_caller]
fn refuse_all(scene: &Scene, logs: &[&str], more: &[&str], code: i32, words: &[&str]) {
    refuse(&mut evaluate(scene, logs, more), code, words);
    assert!(scene.results().is_empty(), "{:?}", scene.results());
}

fn list(value: &Value) -> Vec<&str> {
    value.as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap()).collect()
}

/// The result without the path of its folder.
fn without_folder(mut report: Value) -> Value {
    report.as_object_mut().unwrap().remove("folder");
    report
}

#[test]
fn bands_are_tested_on_touches_that_they_were_not_calibrated_on() {
    let scene = three();
    for (number, elbow) in [(3, 0.2), (4, 0.25), (5, 0.35)] {
        scene.touch(&format!("log/seq_{number}"), 50, elbow);
    }
    let mut run = evaluate(&scene, &["log"], &["--json", "--methods", "map,zero"]);
    let map = json(&mut run)["methods"][0].clone();
    let coverage = &map["coverage"];
    let number = |key: &str| coverage[key].as_f64().unwrap();
    assert_eq!(number("level"), 0.9); // too few touches for own bands: those of other objects
    assert!(number("torque_share") > 0.5);
    assert_eq!(map["coverage_of_other_objects"], *coverage);
    assert!(
        (0.0..=1.0).contains(&number("torque_share"))
            && (0.0..=1.0).contains(&number("peak_share"))
    );
    assert!(number("half_width_n_m") > 0.0 && number("constant_half_width_n_m") > 0.0);
    assert_eq!(coverage["classes"].as_array().unwrap().len(), 3);
    let more = ["--methods", "map,zero", "-o", &scene.text("out/f")];
    let text = succeed(&mut evaluate(&scene, &["log"], &more));
    // These bands are described once.
    holds(&text, &["Bands of map, calibrated on other objects (90 %): they contain"]);
    assert!(!text.contains("Bands calibrated on other objects would contain"), "{text}");
}

#[test]
fn evaluate_prints_the_keys_that_programs_rely_on() {
    let scene = three();
    let report = json(&mut evaluate(&scene, &["log"], &["--json"]));
    assert_eq!(list(&report["methods"]), QUICK.split(',').collect::<Vec<_>>());
    assert_eq!(list(&report["touches"]), ["seq_0", "seq_1", "seq_2"]);
    let touches = report["touches"].as_array().unwrap();
    for (index, method) in report["methods"].as_array().unwrap().iter().enumerate() {
        for key in ["avg_error", "max_error", "avg_relative", "max_relative"] {
            let figures: Vec<f64> = touches
                .iter()
                .map(|touch| touch["methods"][index][key].as_f64().unwrap())
                .collect();
            let mean = figures.iter().sum::<f64>() / 3.0;
            let squares: f64 = figures.iter().map(|figure| (figure - mean).powi(2)).sum();
            let gap = |name: &str, wanted: f64| method[key][name].as_f64().unwrap() - wanted;
            assert!(gap("mean", mean).abs() < 1e-12, "{key} of {method}");
            assert!(gap("std", (squares / 2.0).sqrt()).abs() < 1e-12, "{key} of {method}");
        }
    }
    // Two touches to learn from are too few to calibrate on.
    let map = &report["methods"][0];
    assert_eq!(map["coverage"], map["coverage_of_other_objects"]);
    assert!(report["methods"][4]["coverage"].is_null());
    for (fold, touch) in touches.iter().enumerate() {
        assert_eq!(list(&touch["methods"]), list(&report["methods"]));
        assert_eq!(touch["fold"], fold, "leave-one-touch-out");
        assert!(touch["frames"].as_u64() >= touch["frames_in_contact"].as_u64(), "{touch}");
        assert!(touch["frames_in_contact"].as_u64().unwrap() > 10, "{touch}");
        assert_eq!(touch["methods"][4]["avg_relative"], 1.0, "zero");
    }
    assert_eq!((&report["against"], &report["simulated"]), (&"measured".into(), &false.into()));
    let average = |index: usize| report["methods"][index]["avg_error"]["mean"].as_f64().unwrap();
    assert!(average(0) < average(4), "map learns more than nothing: {report}");
}

#[test]
fn the_table_has_a_row_for_each_method_and_names_the_report() {
    let scene = three();
    let text = succeed(&mut evaluate(&scene, &["log"], &["--folds", "3"]));
    holds(&text, &["3 touches", "against measured external torques", "average", "max. rel.", "±"]);
    let rows = text.lines().skip_while(|line| !line.starts_with("method")).skip(1);
    let rows: Vec<&str> = rows.take_while(|line| !line.is_empty()).collect();
    let first = |row: &&str| row.split(' ').next().unwrap().to_owned();
    assert_eq!(rows.iter().map(first).collect::<Vec<_>>(), QUICK.split(',').collect::<Vec<_>>());
    assert!(text.contains(&scene.text("out/e/report.html")), "{text}");
}

#[test]
fn the_folder_of_results_has_a_self_contained_page_and_all_numbers() {
    let scene = three();
    let methods = ["--methods", "map,mlp,gp,zero"];
    succeed(&mut evaluate(&scene, &["log"], &methods));
    let folder = scene.path("out/e");
    assert_eq!(names(&folder), ["errors.csv", "evaluation.json", "figures", "report.html"]);
    let figures = ["field.svg", "seq_0.svg", "seq_1.svg", "seq_2.svg"];
    let mut found = names(&folder.join("figures"));
    found.retain(|name| name != "index.csv");
    assert_eq!(found, figures);
    let index = fs::read_to_string(folder.join("figures/index.csv")).unwrap();
    assert_eq!(index, "file,touch\nseq_0.svg,seq_0\nseq_1.svg,seq_1\nseq_2.svg,seq_2\n");
    for figure in figures {
        let text = fs::read_to_string(folder.join("figures").join(figure)).unwrap();
        assert!(text.starts_with("<svg"), "{figure}");
    }
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    // The text outside of scripts; a library in a script may contain addresses.
    let pieces = page.split("<script").enumerate().map(|(number, piece)| match number {
        0 => piece.to_owned(),
        _ => {
            let (tag, rest) = piece.split_once('>').unwrap();
            format!("{tag}>{}", rest.split_once("</script>").unwrap().1)
        }
    });
    let page: String = pieces.collect();
    assert!(page.contains("<body") && page.contains("</html>"), "{page}");
    for load in ["src=\"http", "href=\"http", "src='http", "src=\"//", "@import", "url(http"] {
        assert!(!page.contains(load), "the page loads something: {load}");
    }
    let csv = fs::read_to_string(folder.join("errors.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0][..2], ["method", "touch"]);
    let named: Vec<String> = rows[1..].iter().map(|row| row[..2].join(" ")).collect();
    let expected = ["map", "mlp", "gp", "zero"]
        .into_iter()
        .flat_map(|method| ["seq_0", "seq_1", "seq_2"].map(|touch| format!("{method} {touch}")));
    assert_eq!(named, expected.collect::<Vec<_>>());
    let text = fs::read_to_string(folder.join("evaluation.json")).unwrap();
    let whole: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(whole["joint_names"], serde_json::json!(["shoulder", "elbow"]));
    for touch in whole["touches"].as_array().unwrap() {
        let frames = touch["external"].as_array().unwrap().len();
        assert!(frames > 10);
        for prediction in touch["predictions"].as_array().unwrap() {
            assert_eq!(prediction["predicted"].as_array().unwrap().len(), frames);
        }
    }
}

#[test]
fn a_single_touch_leaves_nothing_to_learn_from() {
    let scene = Scene::new();
    refuse_all(&scene, &["log/seq_0"], &[], 1, &["1 touch;", "at least two", "palpate inspect"]);
}

#[test]
fn impossible_divisions_are_refused_with_a_remedy() {
    let scene = three();
    let refuse = |more: &[&str], words: &[&str]| refuse_all(&scene, &["log"], more, 2, words);
    refuse(&["--folds", "4"], &["--folds is 4", "only 3 touches", "3 is leave-one-touch-out"]);
    refuse(&["--folds", "1"], &["--folds", "'1'"]);
    refuse(&["--test", "seq_9"], &["`seq_9`", "their touches are seq_0, seq_1, seq_2"]);
    refuse(&["--test", "seq_0,seq_1,seq_2"], &["every touch", "none is left to learn from"]);
    refuse(&["--test", "seq_0", "--folds", "2"], &["--test", "--folds"]);
    refuse(&["--methods", "map,svm"], &["svm", "map, ekf, mlp, gp, knn, uniform, zero"]);
}

#[test]
fn named_touches_are_predicted_from_all_others_and_each_once() {
    let scene = three();
    let of = |test: &str| {
        without_folder(json(&mut evaluate(&scene, &["log"], &["--json", "--test", test])))
    };
    let both = of("seq_2,seq_0");
    assert_eq!((list(&both["touches"]), &both["folds"]), (vec!["seq_0", "seq_2"], &1.into()));
    assert_eq!(both, of("seq_0,seq_2,seq_0"), "naming a touch twice does not count it twice");
    let whole = json(&mut evaluate(&scene, &["log"], &["--json"]));
    let alone = of("seq_1");
    assert_eq!(alone["touches"][0]["methods"], whole["touches"][1]["methods"]);
}

#[test]
fn touches_of_the_same_name_are_distinguished() {
    let scene = Scene::new();
    for (day, elbow) in [("monday", 0.0), ("tuesday", -0.2)] {
        scene.touch(&format!("{day}/log/seq_0"), 40, elbow);
        scene.touch(&format!("{day}/log/field"), 40, elbow + 0.4);
    }
    let logs = ["monday/log", "tuesday/log"];
    let report = json(&mut evaluate(&scene, &logs, &["--json", "--methods", "map,zero"]));
    let mut touches = list(&report["touches"]);
    assert_eq!(touches.len(), 4);
    let some = touches[0].to_owned();
    touches.sort_unstable();
    touches.dedup();
    assert_eq!(touches.len(), 4, "{touches:?}");
    let figures = names(&scene.path("out/e/figures"));
    assert_eq!(figures.len(), 6, "one a touch, the field, and the index: {figures:?}");
    let one = json(&mut evaluate(&scene, &logs, &["--json", "--methods", "zero", "--test", &some]));
    assert_eq!(list(&one["touches"]), [&some]);
}

#[test]
fn a_log_that_is_given_twice_is_refused() {
    let scene = Scene::new();
    scene.touch("log/seq_0", 40, 0.0);
    let twice = &mut evaluate(&scene, &["log", "log/../log"], &["--methods", "zero"]);
    refuse(twice, 2, &["log/../log` is given twice"]);
}

#[test]
fn a_touch_called_field_keeps_its_figure() {
    let scene = Scene::new();
    scene.touch("log/field", 40, 0.3);
    succeed(&mut evaluate(&scene, &["log"], &["--methods", "zero"]));
    let figures = names(&scene.path("out/e/figures"));
    assert_eq!(figures.len(), 5, "one a touch, the field, and the index: {figures:?}");
}

#[test]
fn touches_of_odd_names_get_figures_of_plain_ones_and_an_index() {
    let scene = Scene::new();
    for name in ["<img src=x>", "=1+1", &"x".repeat(200), "a\u{1b}[31m"] {
        scene.touch(&format!("odd/{name}"), 40, 0.3);
    }
    succeed(&mut evaluate(&scene, &["odd"], &["--methods", "zero"]));
    let figures = names(&scene.path("out/e/figures"));
    let wanted =
        ["field.svg", "index.csv", "touch#2.svg", "touch#3.svg", "touch#4.svg", "touch.svg"];
    assert_eq!(figures, wanted);
    let index = fs::read_to_string(scene.path("out/e/figures/index.csv")).unwrap();
    assert!(index.contains(",<img src=x>\n") && index.contains(",'=1+1\n"), "{index}");
}

#[test]
fn touches_may_differ_in_length_but_not_in_joints() {
    let scene = Scene::new();
    scene.touch("log/long", 90, 0.2);
    let report = json(&mut evaluate(&scene, &["log"], &["--json"]));
    let frames = |touch: usize| report["touches"][touch]["frames"].as_u64().unwrap();
    assert!(frames(0) > frames(1), "{report}");
    fs::remove_dir_all(scene.path("out/e")).unwrap();

    scene.arrays("log/three", &[[0.0; 3]; 40], &[[0.0; 3]; 40]);
    refuse_all(&scene, &["log"], &[], 1, &["three", "3"]);
}

#[test]
fn touches_without_contact_are_evaluated_and_named() {
    let scene = Scene::new();
    let away = ["--json", "--box-low-m", "5,5,5", "--box-high-m", "6,6,6"];
    // All frames are tare, so there is nothing to learn from joint angles alone.
    refuse(&mut evaluate(&scene, &["log"], &away), 1, &["knn on fold", "no frame to learn"]);
    let fields = [&away[..], &["--methods", "map,ekf,uniform,zero"]].concat();
    let (_, said) = printed(&mut evaluate(&scene, &["log"], &fields));
    assert!(said.contains("`seq_0` never leaves its contact-free start"), "{said}");

    // A tare of a known length: there are frames to score, but none with contact.
    let known = [&away[..], &["--tare-frames", "8"]].concat();
    let (_, said) = printed(&mut evaluate(&scene, &["log"], &known));
    assert!(said.contains("`seq_0` touches no point of the lattice"), "{said}");
}

#[test]
fn an_arm_that_stands_still_is_named_and_does_not_keep_others_from_being_scored() {
    let scene = Scene::new();
    scene.arrays("log/still", &[[0.0, 0.3]; 30], &[[0.2, 0.1]; 30]);
    let (report, said) = printed(&mut evaluate(&scene, &["log"], &["--json"]));
    assert!(said.contains("`still` never leaves its contact-free start"), "{said}");
    let report: Value = serde_json::from_str(&report).unwrap();
    assert!(report["touches"][2]["methods"][0]["avg_error"].is_null(), "{report}");
    assert!(report["touches"][0]["methods"][0]["avg_error"].is_f64(), "{report}");
    assert!(report["methods"][0]["avg_error"]["mean"].is_f64(), "{report}");
}

#[test]
fn truth_is_used_if_it_exists_and_otherwise_the_touch_is_named() {
    let scene = Scene::new();
    refuse_all(
        &scene,
        &["log"],
        &["--truth"],
        1,
        &["seq_0", "truth/seq_0_external.npy", "--truth"],
    );
    fs::create_dir(scene.path("log/truth")).unwrap();
    let truth = |touch: &str, rows: usize| {
        let path = scene.path(&format!("log/truth/{touch}_external.npy"));
        npy(&path, &[rows, 2], &vec![5.0; 2 * rows]);
    };
    truth("seq_0", 40);
    refuse_all(&scene, &["log"], &["--truth"], 1, &["truth/seq_1_external.npy"]);
    truth("seq_1", 39);
    refuse_all(&scene, &["log"], &["--truth"], 1, &["seq_1", "39", "40"]);
    truth("seq_1", 40);
    let report = json(&mut evaluate(&scene, &["log"], &["--json", "--truth"]));
    assert_eq!(report["against"], "truth");
    let zero = report["touches"][1]["methods"][4]["max_error"].as_f64().unwrap();
    assert!((zero - 50_f64.sqrt()).abs() < 1e-12, "{zero}");
}

#[test]
fn a_torque_that_is_no_number_is_reported_with_its_sample() {
    let scene = Scene::new();
    let mut torques = [[0.0; 2]; 40];
    torques[20][1] = f64::NAN;
    scene.arrays("log/seq_1", &[[0.0; 2]; 40], &torques);
    refuse_all(&scene, &["log"], &[], 1, &["seq_1/torques.npy", "row 20, column 1"]);
    torques[20][1] = 1e7;
    scene.arrays("log/seq_1", &[[0.0; 2]; 40], &torques);
    refuse_all(&scene, &["log"], &[], 1, &["seq_1", "sample 20", "elbow"]);
}

#[test]
fn quiet_prints_only_the_result_and_warnings() {
    let scene = Scene::new();
    let quiet = |scene: &Scene| {
        let (result, said) = printed(&mut evaluate(scene, &["log"], &["--quiet"]));
        assert!(!result.is_empty());
        said
    };
    assert_eq!(quiet(&scene), "");
    scene.arrays("log/still", &[[0.0, 0.3]; 30], &[[0.2, 0.1]; 30]);
    let message = quiet(&scene);
    assert!(message.starts_with("warning: ") && message.lines().count() == 1, "{message}");
}

#[test]
fn a_folder_that_cannot_be_made_is_refused_before_any_work() {
    let scene = Scene::new();
    let refuse = |place: &str, words: &[&str]| {
        refuse(&mut evaluate(&scene, &["log"], &["-o", place]), 1, words);
    };
    refuse(&scene.text("tiny.urdf"), &["tiny.urdf"]);
    refuse(&scene.text("tiny.urdf/e"), &["tiny.urdf/e", "cannot be written"]);
    if cfg!(target_os = "linux") {
        refuse("/proc/e", &["/proc/e"]);
    }
    fs::create_dir_all(scene.path("out/report.html")).unwrap();
    refuse(&scene.text("out"), &["report.html"]);
}

#[test]
fn a_bad_log_leaves_no_new_folder_and_removes_no_old_one() {
    let scene = Scene::new();
    let nowhere = |place: &str| {
        let output = scene.text(place);
        refuse(&mut evaluate(&scene, &["nowhere"], &["-o", &output]), 1, &["nowhere"]);
    };
    nowhere("out/e");
    nowhere("out/one/in/another");
    assert!(scene.results().is_empty(), "{:?}", scene.results());
    nowhere("out");
    assert!(scene.path("out").is_dir(), "an empty folder that was there before");
}

#[test]
fn the_table_is_printed_even_if_the_report_cannot_be_written() {
    let scene = three();
    let folder = scene.path("out/e");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("figures"), "in the way").unwrap();
    let output = evaluate(&scene, &["log"], &["--methods", "zero"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let (table, error) = (stdout(&output), stderr(&output));
    assert!(table.contains("\nzero ") && !table.contains("report.html"), "{table}");
    assert!(error.contains("figures"), "{error}");
    assert!(names(&folder).contains(&"parts".to_owned()), "what is done is kept");

    fs::remove_file(folder.join("figures")).unwrap();
    succeed(&mut evaluate(&scene, &["log"], &["--methods", "zero"]));
    assert!(!names(&folder).contains(&"parts".to_owned()));
}

#[test]
fn a_folder_parts_of_the_user_is_not_removed() {
    let scene = Scene::new();
    fs::create_dir_all(scene.path("out/e/parts")).unwrap();
    let own = ["part-map-0.json", "part-map-1.json", "bolt.step", "part-of-mine.json"];
    for (name, text) in own.iter().zip(["{\"key\": ", "{\"key\": \"x\"}", "ISO", "{}"]) {
        fs::write(scene.path("out/e/parts").join(name), text).unwrap();
    }
    let methods = ["--json", "--methods", "knn,zero"];
    let (beside, said) = printed(&mut evaluate(&scene, &["log"], &methods));
    assert!(!said.contains("were computed before"), "{said}");
    assert_eq!(names(&scene.path("out/e/parts")), {
        let mut own = own;
        own.sort_unstable();
        own
    });
    let else_where = scene.text("out/f");
    let alone =
        json(evaluate(&scene, &["log"], &[&methods[..], &["-o", &else_where]].concat()).arg("-q"));
    let beside: Value = serde_json::from_str(&beside).unwrap();
    assert_eq!(without_folder(beside), without_folder(alone));
}

#[cfg(unix)]
mod broken_off {
    use std::path::Path;
    use std::process::Stdio;

    use super::*;

    /// Presses Ctrl-C as soon as some parts are kept, and returns how many were, the exit code and
    /// stderr.
    fn press(command: &mut Command, parts: &Path) -> (usize, Option<i32>, String) {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let kept = || {
            let entries = fs::read_dir(parts).into_iter().flatten().flatten();
            let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
            names.filter(|name| name.starts_with("part-") && name.ends_with(".json")).count()
        };
        common::wait_until("a part that is kept", || {
            assert!(child.try_wait().unwrap().is_none(), "it ended before a part was kept");
            kept() > 0
        });
        common::interrupt(&child);
        let output = child.wait_with_output().unwrap();
        assert!(output.stdout.is_empty());
        (kept(), output.status.code(), stderr(&output))
    }

    fn kept_names(scene: &Scene) -> Vec<String> {
        let names = names(&scene.path("out/broken/parts"));
        names.into_iter().filter(|name| name.starts_with("part-")).collect()
    }

    #[test]
    fn the_same_command_continues_and_has_the_result_of_an_uninterrupted_one() {
        let scene = three();
        scene.touch("log/seq_3", 400, -0.2);
        let long = |place: &str| {
            let more = ["--json", "--replays", "100", "-o", &scene.text(place)];
            evaluate(&scene, &["log"], &more)
        };
        let (kept, code, said) = press(&mut long("out/broken"), &scene.path("out/broken/parts"));
        assert_eq!(code, Some(130), "{said}");
        assert!(said.contains("error: interrupted; finished parts are in"), "{said}");
        assert!((1..20).contains(&kept), "{kept} parts of 20");
        assert_eq!(names(&scene.path("out/broken")), ["parts"]);

        let edited = scene.path("out/broken/parts").join(&kept_names(&scene)[0]);
        fs::write(scene.path("out/broken/parts/part-zero-9.json"), "{\"key\": \"foreign\"")
            .unwrap();
        let piece = fs::read_to_string(&edited).unwrap();
        fs::write(&edited, piece.replacen("fold", "bold", 1)).unwrap();
        let (resumed, said) = printed(&mut long("out/broken"));
        let done = kept - 1;
        holds(&said, &["was changed after it was saved: its results are computed again"]);
        assert!(
            done == 0 || said.contains(&format!("{done} parts were computed before")),
            "{said}"
        );
        let resumed: Value = serde_json::from_str(&resumed).unwrap();
        let whole = json(&mut long("out/whole"));
        assert_eq!(without_folder(resumed), without_folder(whole));
    }

    #[test]
    fn parts_of_other_settings_are_not_reused() {
        let scene = three();
        scene.touch("log/seq_3", 400, -0.2);
        let mut long = evaluate(&scene, &["log"], &["--torque-std", "0.3"]);
        let (kept, code, said) = press(&mut long, &scene.path("out/e/parts"));
        assert_eq!(code, Some(130), "{said}");
        assert!(kept > 0);
        let (_, said) = printed(&mut evaluate(&scene, &["log"], &["--json"]));
        assert!(!said.contains("were computed before"), "{said}");
        assert!(!names(&scene.path("out/e")).contains(&"parts".to_owned()), "no parts remain");
    }
}
