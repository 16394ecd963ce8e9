//! Flags over file over defaults, and the template that starts a file.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod common;

use std::fs;

use common::{Scene, holds, palpate, refuse, succeed};

#[test]
fn the_template_holds_every_setting_and_reads_back_as_itself() {
    let scene = Scene::new();
    let template = succeed(palpate().arg("settings"));
    fs::write(scene.path("p.toml"), &template).unwrap();
    let again = succeed(palpate().args(["settings", "--settings", &scene.text("p.toml")]));
    assert_eq!(again, template);
    for key in ["robot", "angle_unit", "tare_frames", "spacing_m", "slip_step_m", "seed"] {
        assert!(template.contains(&format!("\n{key} = ")), "{key} is not in {template}");
    }
    // A value for these would keep `map` from choosing one.
    for key in ["friction", "prior_std"] {
        assert!(template.contains(&format!("\n# {key} = ")), "{key} is not in {template}");
    }
}

#[test]
fn a_flag_beats_the_file_and_the_file_beats_the_default() {
    let scene = Scene::new();
    let text = "[contact]\nfriction = 0.25\nslip_iterations = 7\n[touch]\nno_tare = true\n";
    fs::write(scene.path("p.toml"), text).unwrap();
    let file = scene.text("p.toml");
    let flags = ["--friction", "0.75", "--tare-frames", "12", "--payload-com-m", "-0.1,0,0.5"];
    let settings = succeed(palpate().args(["settings", "--settings", &file]).args(flags));
    for line in [
        "friction = 0.75",
        "slip_iterations = 7",
        "substep_cells = 0.5",
        "tare_frames = 12",
        "no_tare = false",
        "payload_com_m = [-0.1, 0.0, 0.5]",
    ] {
        assert!(settings.contains(&format!("\n{line}\n")), "no `{line}` in {settings}");
    }
}

#[test]
fn each_estimator_has_its_own_defaults() {
    let of = |name: &str| succeed(palpate().args(["settings", "--estimator", name]));
    let mean = |settings: &str| {
        let line = settings.lines().find(|line| line.contains("prior_mean = ")).unwrap();
        line.rsplit(' ').next().unwrap().parse::<f64>().unwrap()
    };
    assert_eq!(mean(&of("map")), 0.0);
    assert!(mean(&of("ekf")) > 0.0);
}

#[test]
fn completions_name_the_subcommands_and_flags() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = succeed(palpate().args(["completions", shell]));
        holds(&script, &["predict", "inspect", "prior-std"]);
    }
}

#[test]
fn the_template_of_a_box_that_does_not_divide_gives_the_same_lattice() {
    let scene = Scene::new();
    let text = "[lattice]\nspacing_m = 0.13\nbox_low_m = [-1.0, -1.0, -1.0]\n";
    fs::write(scene.path("s.toml"), text).unwrap();
    let template = succeed(palpate().args(["settings", "--settings", &scene.text("s.toml")]));
    fs::write(scene.path("t.toml"), template).unwrap();
    let lattice = |settings: &str| {
        let out = scene.text("out/f.npz");
        let more = ["-o", &out, "--settings", &scene.text(settings)];
        succeed(scene.command("map", &["log"]).args(more));
        palpate_io::field::load(out.as_ref()).unwrap().field.lattice
    };
    let (file, template) = (lattice("s.toml"), lattice("t.toml"));
    assert_eq!(file.shape(), [16; 3]);
    assert_eq!(file, template);
}

#[test]
fn a_tare_is_given_in_one_way_only() {
    let scene = Scene::new();
    let file = scene.text("p.toml");
    let mut settings = palpate();
    settings.args(["settings", "--settings", &file]);
    fs::write(&file, "[touch]\nno_tare = true\ntare_frames = 10\n").unwrap();
    refuse(&mut settings, 2, &["p.toml", "no_tare", "tare_frames"]);
    fs::write(&file, "[touch]\ntare_frames = 10\n").unwrap();
    let kept = succeed(settings.arg("--no-tare=false"));
    assert!(kept.contains("\ntare_frames = 10\n"), "{kept}");
}

#[test]
fn values_out_of_range_are_refused() {
    for (flag, value, key) in [
        ("--bake-spacing-m", "0.06", "bake_spacing_m"),
        ("--replays", "100001", "replays"),
        ("--torque-std", "-3", "torque_std"),
        ("--prior-std", "0", "prior_std"),
        ("--prior-mean", "-1", "prior_mean"),
        ("--friction", "-0.1", "friction"),
        ("--contact-distance-m", "0.05", "contact_distance_m"),
        ("--still-rad", "-1", "still_rad"),
        ("--idle-s", "-1", "idle_s"),
    ] {
        refuse(palpate().args(["settings", flag, value]), 2, &["bad setting", key, value]);
    }
    succeed(palpate().args(["settings", "--bake-spacing-m", "0.05", "--replays", "100000"]));
}

#[test]
fn help_shows_the_defaults() {
    let help =
        succeed(palpate().args(["map", "--help"])).split_whitespace().collect::<Vec<_>>().join(" ");
    holds(&help, &["[default: 0.024]", "[default: 0.2 for map, 1.5 for ekf]"]);
}
