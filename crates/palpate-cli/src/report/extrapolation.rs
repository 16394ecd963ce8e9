//! The page of an extrapolation: an interactive Fig. 4, with its numbers and settings.

use askama::Template;
use serde::Serialize;

use super::packed::{self, PER_ONE, four_digits};
use super::page::Page;
use super::scene::Scene;
use crate::extrapolation_view::{ExtrapolationView, Table, reached_by};
use crate::picture;

/// Largest number of drawn points of the cloud: with more, a browser rotates them slowly.
const POINTS: usize = 30_000;
/// Share of the cloud's points whose standard deviation is above the top of its colour bar.
const BEYOND: f64 = 0.02;

/// The page.
#[derive(Template)]
#[template(path = "extrapolation.html")]
pub(crate) struct ExtrapolationPage<'a> {
    pub(crate) page: Page<'a>,
    /// What was found, as one sentence without its full stop.
    pub(crate) verdict: String,
    pub(crate) seen: &'a ExtrapolationView<'a>,
    /// The field and the arm.
    pub(crate) scene: Scene,
    pub(crate) tables: Vec<Table>,
}

#[derive(Serialize)]
struct Data<'a> {
    per_one: f64,
    /// Initial threshold of the stiffness, N/m.
    threshold: f64,
    /// Stiffness at the ends of the colour bar, N/m.
    range: [f64; 2],
    /// Initial direction from the object to the eye: a unit vector.
    eye: [f64; 3],
    scene: &'a Scene,
    cloud: Cloud,
}

/// The points of the cloud that are drawn.
#[derive(Serialize)]
struct Cloud {
    /// Number of points of the whole cloud.
    all: usize,
    /// x, y, z of each point, in tenths of a millimetre.
    points: Vec<i64>,
    /// Six hexadecimal digits for each point, in one text.
    colours: String,
    /// Stiffness of each point, N/m.
    stiffness: Vec<f64>,
    /// Standard deviation of each stiffness, N/m.
    std: Vec<f64>,
    /// Standard deviation at the top of its colour bar, N/m.
    std_top: f64,
    /// `1` for each touched point, else `0`, in one text.
    touched: String,
}

impl ExtrapolationPage<'_> {
    /// The JSON data of the figures.
    fn data(&self) -> Data<'_> {
        Data {
            per_one: PER_ONE,
            threshold: self.seen.threshold_n_per_m(),
            range: self.seen.colour_range_n_per_m(),
            eye: picture::View::of(&self.seen.middle()).towards().into(),
            scene: &self.scene,
            cloud: Cloud::of(self.seen),
        }
    }
}

impl Cloud {
    fn of(seen: &ExtrapolationView<'_>) -> Self {
        let all = seen.points.len();
        let drawn = || (0..all.min(POINTS)).map(|n| n * all / all.min(POINTS));
        let colour = |at: usize| {
            let [red, green, blue] = seen.colours[at];
            format!("{red:02x}{green:02x}{blue:02x}")
        };
        let digits = |of: &[f64]| drawn().map(|at| four_digits(of[at])).collect();
        let std_top = reached_by(seen.found.std_n_per_m.iter().copied(), BEYOND);
        Self {
            all,
            points: drawn().flat_map(|at| packed::tenths(&seen.points[at])).collect(),
            colours: drawn().map(colour).collect(),
            stiffness: digits(&seen.found.stiffness_n_per_m),
            std: digits(&seen.found.std_n_per_m),
            std_top: four_digits(std_top.max(1e-6)),
            touched: drawn().map(|at| if seen.found.touched[at] { '1' } else { '0' }).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extrapolation_view::tests::Example;

    #[test]
    fn a_large_cloud_is_thinned_evenly() {
        let cloud = |points| Cloud::of(&Example::new(0, points).seen());
        assert_eq!(cloud(1_000).stiffness.len(), 1_000);
        let thinned = cloud(100_000);
        assert_eq!((thinned.all, thinned.stiffness.len()), (100_000, POINTS));
        assert_eq!((thinned.points.len(), thinned.colours.len()), (3 * POINTS, 6 * POINTS));
        assert_eq!(thinned.touched.len(), POINTS);
        // The points go in order from pole to pole: the upper half keeps half of them.
        let upper = thinned.points.iter().skip(2).step_by(3).filter(|&&z| z > 5_000).count();
        assert!(upper.abs_diff(POINTS / 2) < POINTS / 1_000, "{upper}");
        assert_eq!(cloud(0).stiffness.len(), 0);
    }

    #[test]
    fn words_cannot_break_out_of_a_page() {
        let example = Example::new(0, 0);
        let seen = example.seen();
        let table = Table {
            title: "<i>",
            caption: "",
            head: vec!["class", "K & σ"],
            rows: vec![vec!["</table>".to_owned(), "1.5".to_owned()]],
        };
        let page = ExtrapolationPage {
            page: Page {
                title: "</title>",
                simulated: false,
                card: vec![("robot", "a<b \"'".to_owned())],
                settings_toml: "</pre>",
            },
            verdict: "{{ page.title }} <b>".to_owned(),
            scene: Scene::seen(&seen).unwrap(),
            seen: &seen,
            tables: vec![table],
        };
        let html = page.render().unwrap();
        for safe in [
            "<title>&#60;/title&#62;</title>",
            "<p class=\"verdict\">{{ page.title }} &#60;b&#62;.</p>",
            "&#60;i&#62;</h2>",
            "<th scope=\"col\">K &#38; σ</th>",
            "<th scope=\"row\">&#60;/table&#62;</th><td>1.5</td>",
            "<dt>robot</dt><dd>a&#60;b &#34;&#39;</dd>",
            "<pre tabindex=\"0\">&#60;/pre&#62;</pre>",
        ] {
            assert!(html.contains(safe), "{safe}");
        }
        let tables = &html[html.find("aria-labelledby=\"table-0\"").unwrap()..];
        let table = &tables[..tables.find("</section>").unwrap()];
        assert!(!table.contains("class=\"caption\""));
    }
}
