//! An evaluation and a scene made up for tests: three touches, four methods, an arm of seven joints, two of whose links
//! have shapes.

use palpate::{Arm, BakeConfig, ContactConfig, ExternalTorqueConfig, Field, Lattice, Robot};
use palpate_learn::evaluation::{Evaluation, HeldOutTouch, MethodPrediction, MethodSummary};

/// Each method, and the share of the torque that it predicts.
const METHODS: [(&str, f64); 4] = [("map", 0.7), ("gp", 0.2), ("knn", -0.1), ("zero", 0.0)];
const FRAMES: usize = 200;
const JOINTS: usize = 7;

/// Touches that push in and come back, at 20 Hz; some names contain HTML, which pages must escape.
pub(crate) fn evaluation() -> Evaluation {
    let names = ["first", "second <touch>", "third </script>"];
    let touches: Vec<HeldOutTouch> =
        names.iter().enumerate().map(|(n, name)| touch(n, name)).collect();
    let rows = METHODS.iter().enumerate();
    Evaluation {
        joint_names: (1..=JOINTS).map(|joint| format!("joint_{joint}")).collect(),
        against: "truth".to_owned(),
        methods: rows.map(|(index, (name, _))| MethodSummary::new(name, index, &touches)).collect(),
        touches,
    }
}

fn touch(number: usize, name: &str) -> HeldOutTouch {
    let push = |frame: usize| (frame as f64 / FRAMES as f64 * std::f64::consts::PI).sin();
    let frame = |frame: usize| -> Vec<f64> {
        let phase = |joint: usize| (joint as f64 * 1.3 + number as f64).sin();
        (0..JOINTS).map(|joint| 2.0 * push(frame) * phase(joint)).collect()
    };
    let external: Vec<Vec<f64>> = (0..FRAMES).map(frame).collect();
    let predicted = |&(method, part): &(&str, f64)| {
        let scale = |tau: &Vec<f64>| tau.iter().map(|tau| part * tau).collect();
        MethodPrediction::new(method, external.iter().map(scale).collect(), &external)
    };
    HeldOutTouch {
        name: name.to_owned(),
        fold: number,
        time_s: (0..FRAMES).map(|frame| 0.05 * frame as f64).collect(),
        contacts: (0..FRAMES).map(|frame| (300.0 * push(frame)) as u32).collect(),
        known: (0..FRAMES).map(|frame| (200.0 * push(frame)) as u32).collect(),
        q: (0..FRAMES).map(|at| vec![0.5 * push(at) + 0.1 * number as f64; JOINTS]).collect(),
        predictions: METHODS.iter().map(predicted).collect(),
        external,
    }
}

/// Seven joints, of which the third and the last carry a rod.
pub(crate) fn arm() -> Arm {
    let mut urdf = "<robot name='rods'><link name='link_0'/>".to_owned();
    for joint in 1..=JOINTS {
        let rod = "<collision><origin xyz='0 0 0.05'/><geometry><cylinder radius='0.03' \
                   length='0.2'/></geometry></collision>";
        let rod = if joint % 4 == 3 { rod } else { "" };
        let axis = if joint % 2 == 1 { "0 0 1" } else { "0 1 0" };
        urdf += &format!(
            "<link name='link_{joint}'>{rod}</link><joint name='joint_{joint}' \
             type='continuous'><origin xyz='0 0 0.1'/><parent link='link_{}'/><child \
             link='link_{joint}'/><axis xyz='{axis}'/></joint>",
            joint - 1
        );
    }
    let robot = Robot::from_urdf(&(urdf + "</robot>")).unwrap();
    let config = BakeConfig::new(0.01, 0.02);
    Arm::bake(robot, &config, |_| Err("no meshes".into())).unwrap().0
}

/// A ball of cells whose stiffness spans four decades.
pub(crate) fn field() -> Field {
    let lattice = Lattice::new([0.2, -0.2, 0.3], 0.02, [20, 20, 20]).unwrap();
    let places = (0..20_u32.pow(3)).map(|n| [n % 20, n / 20 % 20, n / 400]);
    let (mut cells, mut stiffness_n_per_m) = (Vec::new(), Vec::new());
    for place in places {
        let distance = place.iter().map(|&n| (f64::from(n) - 9.5).powi(2)).sum::<f64>().sqrt();
        if distance < 9.0 {
            cells.push(lattice.cell(place));
            stiffness_n_per_m.push(100.0 / 10_f64.powf(distance / 2.25));
        }
    }
    let n = cells.len();
    let (contact, touch) = (ContactConfig::default(), ExternalTorqueConfig::default());
    let mut field = Field::new(lattice, contact, touch, 0.0);
    (field.cells, field.stiffness_n_per_m) = (cells, stiffness_n_per_m);
    (field.std_n_per_m, field.counts) = (vec![1.0; n], vec![1; n]);
    field
}
