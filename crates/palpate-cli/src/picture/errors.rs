//! Error over time of one touch: every method's, beside the size of the torque itself (Fig. 3).

use palpate_learn::evaluation::HeldOutTouch;
use plotters::chart::ChartBuilder;
use plotters::series::LineSeries;
use plotters::style::{Color, RGBColor};

use super::draw::{INK, LEGEND_HEIGHT, legend, mesh, svg, text};

const SIZE: (u32, u32) = (1000, 460);
const TORQUE: RGBColor = RGBColor(169, 174, 184);

/// Draws a touch, with its name above.
///
/// The error of predicting zero is the size of the torque, one curve for both.
pub(crate) fn errors(touch: &HeldOutTouch) -> Result<String, String> {
    let zero = vec![Vec::new(); touch.external.len()];
    let mut curves = vec![("zero (|τ|)", TORQUE.stroke_width(1), norms(&touch.external, &zero))];
    for method in touch.predictions.iter().filter(|method| method.method != "zero") {
        let width = if method.method == "map" { 3 } else { 2 };
        let style = colour(&method.method).stroke_width(width);
        curves.push((&method.method, style, norms(&touch.external, &method.predicted)));
    }
    svg(SIZE, |area| {
        let (head, body) = area.split_vertically(LEGEND_HEIGHT);
        let room = |name: &str| 64 + 9 * name.chars().count() as i32;
        legend(&head, curves.iter().map(|&(name, style, _)| (name, style, room(name))))?;
        let largest = curves.iter().flat_map(|(.., errors)| errors.iter().copied());
        let largest = largest.filter(|error| error.is_finite()).fold(0.1, f64::max);
        let last = touch.time_s.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let first = touch.time_s.first().map_or(0.0, |&first| first.min(last));
        let mut chart = ChartBuilder::on(&body)
            .margin(8)
            .margin_right(16)
            .caption(&touch.name, text(18))
            .x_label_area_size(40)
            .y_label_area_size(54)
            .build_cartesian_2d(first..last, 0.0..1.05 * largest)?;
        mesh(&mut chart, 13)
            .disable_x_mesh()
            .x_labels(8)
            .y_labels(6)
            .x_desc(if counted(touch) { "frame" } else { "time [s]" })
            .y_desc("error [N·m]")
            .draw()?;
        for (_, style, errors) in &curves {
            let at = touch.time_s.iter().copied().zip(errors.iter().copied());
            chart
                .draw_series(LineSeries::new(at.filter(|(_, error)| error.is_finite()), *style))?;
        }
        Ok(())
    })
}

/// Whether a touch's time is the frame number, because its log has no clock.
pub(crate) fn counted(touch: &HeldOutTouch) -> bool {
    touch.time_s.iter().enumerate().all(|(frame, &time)| time == frame as f64)
}

/// ‖a − b‖₂ of every frame; an empty vector counts as zero.
fn norms(a: &[Vec<f64>], b: &[Vec<f64>]) -> Vec<f64> {
    let norm = |(a, b): (&Vec<f64>, &Vec<f64>)| {
        let b = b.iter().chain(std::iter::repeat(&0.0));
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    };
    a.iter().zip(b).map(norm).collect()
}

/// Okabe and Ito's colours, which colour-blind readers can distinguish. Their yellow is hard to see on white: `elastic` is
/// a brown that is lighter than the ink of the measured torque and darker than all others.
pub(crate) fn colour(method: &str) -> RGBColor {
    match method {
        "elastic" => RGBColor(150, 75, 20),
        "map" => RGBColor(0, 114, 178),
        "ekf" => RGBColor(86, 180, 233),
        "mlp" => RGBColor(213, 94, 0),
        "gp" => RGBColor(0, 158, 115),
        "knn" => RGBColor(204, 121, 167),
        "uniform" => RGBColor(230, 159, 0),
        "zero" => RGBColor(138, 144, 156),
        _ => INK,
    }
}

#[cfg(test)]
mod tests {
    use palpate_learn::evaluation::MethodPrediction;
    use palpate_learn::method::Method;

    use super::*;

    fn touch(frames: usize) -> HeldOutTouch {
        let external = vec![vec![3.0, 4.0]; frames];
        HeldOutTouch {
            name: "push".to_owned(),
            fold: 0,
            time_s: (0..frames).map(|frame| 0.1 * frame as f64).collect(),
            contacts: vec![0; frames],
            known: vec![0; frames],
            q: vec![vec![0.0; 2]; frames],
            predictions: ["map", "gp", "zero"]
                .map(|name| MethodPrediction::new(name, vec![vec![0.0; 2]; frames], &external))
                .into(),
            external,
        }
    }

    #[test]
    fn the_torque_is_its_own_error_of_predicting_zero() {
        assert_eq!(norms(&[vec![3.0, 4.0]], &[vec![]]), [5.0]);
        assert_eq!(norms(&[vec![3.0, 4.0]], &[vec![3.0, 3.0]]), [1.0]);
    }

    #[test]
    fn every_method_has_its_own_colour() {
        let channels = |RGBColor(red, green, blue)| [red, green, blue].map(i32::from);
        let named = Method::ALL.map(|method| channels(colour(method.name())));
        let all = [&named[..], &[channels(INK)]].concat();
        for (index, a) in all.iter().enumerate() {
            for b in &all[..index] {
                let difference: i32 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
                assert!(difference > 80, "{a:?} and {b:?}");
            }
        }
    }

    #[test]
    fn every_method_has_its_line_and_zero_shares_that_of_the_torque() {
        let drawn = errors(&touch(20)).unwrap();
        for word in ["map", "gp", "zero (|τ|)", "push", "time [s]", "error [N·m]"] {
            assert!(drawn.contains(word), "{word}");
        }
        assert!(!drawn.contains("NaN"));
    }

    #[test]
    fn a_touch_without_frames_is_an_empty_picture() {
        assert!(errors(&touch(0)).unwrap().starts_with("<svg"));
        assert!(errors(&touch(1)).is_ok());
    }
}
