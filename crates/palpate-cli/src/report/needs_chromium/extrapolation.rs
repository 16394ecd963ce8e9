//! The page of an extrapolation.

use askama::Template;

use super::super::{ExtrapolationPage, Page as PageText, Scene};
use super::{Page, eye};
use crate::extrapolation_view::Table;
use crate::extrapolation_view::tests::Example;

fn page(example: &Example) -> Page {
    let table = Table {
        title: "Stiffness of <parts>",
        caption: "Medians.",
        head: vec!["part", "K [N/m]"],
        rows: vec![vec!["leaf".to_owned(), "5.3".to_owned()]],
    };
    let page = PageText {
        title: "What is stiff </script>",
        simulated: true,
        card: vec![("cloud", "made up".to_owned())],
        settings_toml: "[estimator]\nmethod = \"map\"\n",
    };
    let (seen, verdict) = (&example.seen(), "One point in seven is stiff".to_owned());
    let scene = Scene::seen(seen).unwrap();
    let page = ExtrapolationPage { page, verdict, seen, scene, tables: vec![table] };
    Page::open(&page.render().unwrap())
}

fn drawn(plot: &str) -> String {
    format!(
        "document.querySelector('#{plot} canvas') !== null && document.getElementById('{plot}')\
         ._fullLayout?.scene?._scene?.glplot != null"
    )
}

const POINTS: &str = "document.getElementById('field').data[1].x.length";
const COLOURS: &str = "document.getElementById('cloud').data[0].marker.color";
const VERTICES: &str = "document.getElementById('field').data[0].x.length";

#[test]
fn the_page_of_an_extrapolation_answers_its_reader() {
    let page = page(&Example::new(3, 2_000));
    everything_is_drawn(&page);
    the_slider_hides_soft_points(&page);
    the_arm_goes_where_it_is_sent(&page);
    every_colouring_has_its_colours(&page);
    for [turned, other] in [["cloud", "field"], ["field", "cloud"]] {
        page.the_view_turns(turned);
        let [turned, other] = [turned, other].map(eye);
        // A view glides on a little after the mouse has let go of it.
        page.until(&format!("Math.abs({turned}.x - {other}.x) < 0.05"));
    }
    page.resize(400, 900);
    page.until("document.documentElement.scrollWidth <= 400");
    page.until("document.querySelector('#cloud canvas').getBoundingClientRect().width < 400");
    page.nothing_was_wrong();
}

#[test]
fn a_page_without_touches_or_cloud_shows_the_field() {
    let page = page(&Example::new(0, 0));
    page.until(&drawn("field"));
    assert!(page.number(POINTS) > 0.0);
    assert_eq!(page.ask("document.getElementById('arm').disabled"), true);
    page.nothing_was_wrong();
}

#[test]
fn a_page_without_anything_says_so() {
    let mut example = Example::new(0, 0);
    example.field.counts.fill(0);
    let page = page(&example);
    page.until("document.getElementById('cloud-caption').textContent.startsWith('0 points')");
    assert_eq!(page.number(POINTS), 0.0);
    page.nothing_was_wrong();
}

fn everything_is_drawn(page: &Page) {
    for plot in ["field", "cloud"] {
        page.until(&drawn(plot));
        let colours = page.colours(plot);
        assert!(colours > 50.0, "{plot} shows {colours} colours");
    }
    let text = page.ask("document.body.innerText");
    let text = text.as_str().unwrap();
    for words in [
        "What is stiff </script>",
        "One point in seven is stiff.",
        "The touches are simulated.",
        "Stiffness of <parts>",
        "2,000 points that the camera sees, coloured by extrapolated stiffness",
    ] {
        assert!(text.contains(words), "{words}");
    }
    let style = "getComputedStyle(document.querySelector('tbody td')).textAlign";
    assert_eq!(page.ask(style), "right");
}

fn the_slider_hides_soft_points(page: &Page) {
    let all = Example::new(0, 0).seen().cells().count();
    let at_first = page.number(POINTS) / all as f64;
    assert!((0.03..0.08).contains(&at_first), "{at_first} of all are shown at first");
    page.set("threshold", "0", "input");
    page.until(&format!("{POINTS} === {all}"));
    page.set("threshold", "60", "input");
    page.until(&format!("{POINTS} < {all} && {POINTS} > 0"));
    let label = page.ask("document.getElementById('threshold-shown').textContent");
    let shown = page.number(POINTS);
    assert!(label.as_str().unwrap().contains(&format!("({shown} shown)")), "{label}");
}

fn the_arm_goes_where_it_is_sent(page: &Page) {
    let first = "document.getElementById('field').data[0].x[0]";
    let (one, at_first) = (page.number(VERTICES), page.ask(first));
    page.set("arm", "1", "change");
    assert_ne!(page.ask(first), at_first);
    page.set("arm", "3", "change");
    assert_eq!(page.number(VERTICES), 3.0 * one);
    page.set("arm", "0", "change");
    assert_eq!((page.number(VERTICES), page.ask(first)), (one, at_first));
}

fn every_colouring_has_its_colours(page: &Page) {
    let kinds = "document.getElementById('colouring').options.length";
    assert_eq!(page.number(kinds), 4.0);
    let stiff = page.number(&format!("{COLOURS}[0]"));
    assert!((stiff - 300_f64.log10()).abs() < 1e-3, "{stiff}");
    page.set("colouring", "1", "change");
    assert_eq!(page.number(&format!("{COLOURS}[1]")), 2_f64.log10());
    page.set("colouring", "2", "change");
    assert_eq!(page.ask(&format!("{COLOURS}[1]")), "#28a014");
    page.set("colouring", "3", "change");
    assert_eq!(page.ask(&format!("[{COLOURS}[0], {COLOURS}[1]]")), serde_json::json!([1, 0]));
    page.set("colouring", "0", "change");
}
