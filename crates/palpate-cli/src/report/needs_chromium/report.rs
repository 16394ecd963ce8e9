//! The report of an evaluation.

use askama::Template;
use serde_json::Value;

use super::super::{Page as PageText, Report, Scene};
use super::Page;
use crate::example;
use crate::hull::Hulls;

fn report(scene: bool) -> String {
    let evaluation = example::evaluation();
    let scene = scene.then(|| Scene::new(&example::arm(), &example::field(), &evaluation).unwrap());
    let page = PageText {
        title: "An example",
        simulated: true,
        settings_toml: "[estimator]\nmethod = \"map\"\n",
        card: vec![("log", "made up".to_owned())],
    };
    Report { page, evaluation: &evaluation, scene }.render().unwrap()
}

#[test]
fn the_report_opens_without_a_network_and_answers_its_reader() {
    let page = Page::open(&report(true));
    everything_is_drawn(&page);
    another_touch_changes_the_curves(&page);
    another_method_changes_the_joints(&page);
    a_threshold_hides_soft_points(&page);
    the_arm_moves_with_the_frame(&page);
    page.the_view_turns("scene");
    nothing_sticks_out_of_a_narrow_window(&page);
    page.nothing_was_wrong();
}

#[test]
fn a_report_without_a_scene_shows_the_rest() {
    let page = Page::open(&report(false));
    page.until("document.querySelectorAll('#error .scatterlayer .trace').length === 4");
    assert_eq!(page.ask("document.getElementById('scene')"), Value::Null);
    page.set("touch", "2", "change");
    page.until("document.querySelectorAll('#joint-6 .trace').length === 2");
    page.nothing_was_wrong();
}

const DRAWN: &str = "document.querySelectorAll('#error .scatterlayer .trace').length === 4 && \
                     document.querySelector('#scene canvas') !== null && \
                     document.getElementById('scene')._fullLayout?.scene?._scene?.glplot != null";

/// Every plot has its curves; zero's error is the torque itself, one curve for both.
fn everything_is_drawn(page: &Page) {
    page.until(DRAWN);
    for joint in 0..7 {
        page.until(&format!("document.querySelectorAll('#joint-{joint} .trace').length === 2"));
    }
    page.until("document.querySelectorAll('#contacts .trace').length === 2");
    let colours = page.colours("scene");
    assert!(colours > 50.0, "the scene shows {colours} colours");
    assert_eq!(page.number("document.querySelectorAll('tbody tr').length"), 4.0);
    let text = page.ask("document.body.innerText");
    let text = text.as_str().unwrap();
    for sentence in ["The touches are simulated.", "map: average relative error 0.30 ± 0.00; best"]
    {
        assert!(text.contains(sentence), "{sentence}");
    }
}

fn another_touch_changes_the_curves(page: &Page) {
    let curve = "Array.from(document.getElementById('error').data[1].y)";
    let before = page.ask(curve);
    page.set("touch", "1", "change");
    assert_ne!(page.ask(curve), before);
    let external = &example::evaluation().touches[1].external[100];
    let error = 0.3 * external.iter().map(|tau| tau * tau).sum::<f64>().sqrt();
    let drawn = page.number("document.getElementById('error').data[1].y[100]");
    assert!((drawn - error).abs() < 2e-3, "{drawn} N·m drawn for {error}");
}

fn another_method_changes_the_joints(page: &Page) {
    page.set("method", "1", "change");
    assert_eq!(page.ask("document.getElementById('joint-0').data[1].name"), "gp");
    assert_eq!(page.ask("document.getElementById('contacts').data[1].name"), "error of gp");
}

fn a_threshold_hides_soft_points(page: &Page) {
    let points = "document.getElementById('scene').data[1].x.length";
    page.set("threshold", "0", "input");
    let all = example::field().cells.len();
    page.until(&format!("{points} === {all}"));
    page.set("threshold", "60", "input");
    page.until(&format!("{points} < {all} && {points} > 0"));
    let softest = page.number("Math.min(...document.getElementById('scene').data[1].customdata)");
    let stiffest = example::field().stiffness_n_per_m.into_iter().fold(0.0, f64::max);
    assert!(softest >= 0.099 * stiffest, "{softest} N/m is shown"); // a decade, 40 % of 2.5
    let label = page.ask("document.getElementById('threshold-shown').textContent");
    let shown = page.number(points);
    assert!(label.as_str().unwrap().contains(&format!("({shown} shown)")), "{label}");
}

fn the_arm_moves_with_the_frame(page: &Page) {
    let vertices = "Array.from(document.getElementById('scene').data[0].x)";
    page.set("frame", "0", "input");
    page.until("document.getElementById('frame-shown').textContent.includes('frame 0')");
    page.until("document.getElementById('error').layout.shapes[0].x0 === 0");
    let at_rest = page.ask(vertices);
    page.set("frame", "120", "input");
    page.until("document.getElementById('error').layout.shapes[0].x0 > 5");
    assert_ne!(page.ask(vertices), at_rest);

    // A vertex of the last link stands where the kinematics say.
    let (arm, evaluation) = (example::arm(), example::evaluation());
    let hulls = Hulls::of(&arm);
    let poses = hulls.poses(&arm, &evaluation.touches[1].q[120]).unwrap();
    let vertex = poses.last().unwrap() * hulls.hulls.last().unwrap().vertices_m.last().unwrap();
    for (axis, along) in ["x", "y", "z"].into_iter().enumerate() {
        let shown =
            page.number(&format!("document.getElementById('scene').data[0].{along}.at(-1)"));
        assert!((shown - vertex[axis]).abs() < 5e-4, "{along}: {shown} for {}", vertex[axis]);
    }
}

fn nothing_sticks_out_of_a_narrow_window(page: &Page) {
    page.resize(400, 900);
    page.until("document.querySelector('#error .main-svg').getBoundingClientRect().width < 400");
    page.until("document.documentElement.scrollWidth <= 400");
    page.until("document.querySelector('#scene canvas').getBoundingClientRect().width < 400");
}
