//! Stiffness and contact of a simulated body are found again, and a wrong body does not make a field worse.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::sync::{Arc, Mutex};

use palpate::unstable::{
    ElasticBody, ElasticContactConfig, ElasticModel, ElasticTorque, Equilibrium, Segment,
    SegmentKind,
};
use palpate::{
    Arm, BakeConfig, EstimatorKind, Lattice, Mapper, MapperConfig, PathConfig, PathPredictor,
    Predictor, Robot, Sample,
};
use palpate_learn::bands::Uncertainty;
use palpate_learn::elastic::{self, CONTACT_CANDIDATES, ElasticBodyLearner};
use palpate_learn::evaluate::{EvaluationPlan, FoldPrediction};
use palpate_learn::folds::{Fold, folds};
use palpate_learn::method::Method;
use palpate_learn::tracked::{TouchSamples, TrackedTouches};

const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

/// A rod that turns about the vertical, on a slide along x.
fn arm() -> Arc<Arm> {
    let urdf = r#"<robot name="paddle"><link name="base"/><link name="slide"/><link name="rod">
         <collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.04 0.04"/></geometry></collision>
         </link>
         <joint name="along" type="prismatic"><parent link="base"/><child link="slide"/>
         <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
         <joint name="turn" type="continuous"><parent link="slide"/><child link="rod"/>
         <axis xyz="0 0 1"/></joint></robot>"#;
    let robot = Robot::from_urdf(urdf).unwrap();
    Arc::new(Arm::bake(robot, &BakeConfig::default(), |_| unreachable!()).unwrap().0)
}

/// Three stems beside the rod.
fn body() -> Arc<ElasticBody> {
    let mut segments = Vec::new();
    for stem in 0..3_u32 {
        for piece in 0..6_u32 {
            let x = 0.2 + 0.1 * f64::from(stem);
            let z = |piece: u32| -0.25 + 0.06 * f64::from(piece);
            segments.push(Segment {
                parent: piece.checked_sub(1).map(|below| 6 * stem + below),
                kind: SegmentKind::Wood,
                start_m: [x, 0.1, z(piece)],
                end_m: [x + 0.003, 0.1, z(piece + 1)],
                bare_m: 0.0,
                radius_m: 0.008,
                half_width_m: [0.0; 3],
                joint_stiffness: 20.0,
                branch: stem,
            });
        }
    }
    Arc::new(ElasticBody::new(segments).unwrap())
}

fn config() -> MapperConfig {
    let mut config = MapperConfig::of(EstimatorKind::Map);
    config.lattice = Lattice::filling([-0.3, -0.3, -0.3], [0.8, 0.5, 0.3], 0.03).unwrap();
    config.estimator.replays = 3;
    config
}

/// Simulated touches of a body that is stiffer by a factor, with this friction.
fn touches(arm: &Arc<Arm>, factor: f64, friction: f64) -> Vec<TouchSamples> {
    touches_of(&body(), arm, factor, friction)
}

fn touches_of(
    body: &Arc<ElasticBody>,
    arm: &Arc<Arm>,
    factor: f64,
    friction: f64,
) -> Vec<TouchSamples> {
    let touch = |number: usize| {
        let config = ElasticContactConfig { friction, ..ElasticContactConfig::default() };
        let mut equilibrium = Equilibrium::new(Arc::clone(arm), Arc::clone(body), config);
        let sample = |frame: usize| {
            let way = frame.saturating_sub(8) as f64 / 40.0;
            let q = vec![-0.05 * number as f64 + 0.05 * way, 0.5 * way];
            let poses = arm.robot.forward(&q).unwrap();
            equilibrium.advance(&poses.world_from_link, Some(0.0));
            let tau = equilibrium.torques(&poses).column_sum() * factor;
            Sample::new(None, q, tau.as_slice().to_vec())
        };
        TouchSamples {
            name: format!("touch_{number}"),
            samples: (0..48).map(sample).collect(),
            truth: None,
        }
    };
    (0..4).map(touch).collect()
}

fn tracked(arm: &Arc<Arm>, body: &Arc<ElasticBody>, touches: &[TouchSamples]) -> TrackedTouches {
    let tracked = TrackedTouches::new(arm, &config(), touches, NEVER).unwrap();
    let (bodies, training) = (std::slice::from_ref(body), [vec![0, 1, 2, 3]]);
    tracked.with_bodies(arm, bodies, (touches, &training), (NEVER, &|| ())).unwrap()
}

#[test]
fn stiffness_and_friction_of_a_known_body_come_back() {
    let arm = arm();
    let friction = CONTACT_CANDIDATES[1][0];
    let touches = touches(&arm, 2.0, friction);
    let tracked = tracked(&arm, &body(), &touches);
    for fold in folds(4, 4) {
        let found = elastic::predict(&tracked, &fold, &config(), NEVER).unwrap();
        assert_eq!(found.constants.friction(), friction);
        let factor = found.constants.stiffness_factor();
        assert!((factor / 2.0).ln().abs() < 0.04, "{factor}, wanted 2");
        assert!(found.weights.field < 0.1, "{:?}", found.weights);
        let wanted = &tracked.touches[fold.test[0]].frames;
        let peak = wanted.iter().map(|frame| frame.target[1].abs()).fold(0.0, f64::max);
        assert!(peak > 1.0, "the touch reaches {peak} N·m");
        for (torque, frame) in found.torques[0].iter().zip(wanted) {
            let off = (torque[1] - frame.target[1]).abs();
            assert!(off < 0.1 * peak, "{} N·m, wanted {}", torque[1], frame.target[1]);
        }
    }
}

#[test]
fn a_field_with_its_body_predicts_what_was_predicted_of_the_touch_left_out() {
    let arm = arm();
    // Twice as far, so that field, body and both have a weight above 0.
    let mut touches = touches(&arm, 2.0, CONTACT_CANDIDATES[1][0]);
    touches.iter_mut().flat_map(|touch| &mut touch.samples).for_each(|s| s.tau[0] += s.q[1]);
    let tracked = tracked(&arm, &body(), &touches);
    let fold = &folds(4, 4)[2];
    let found = elastic::predict(&tracked, fold, &config(), NEVER).unwrap();
    let learnt =
        palpate_learn::method::learn(&tracked, &fold.train, &config(), &[], NEVER).unwrap();
    let mut field = palpate_learn::method::field(&tracked, learnt.as_ref(), &config());
    let mut model = elastic::model(&tracked, &fold.train, &config(), NEVER).unwrap();
    model.check(&field.lattice).unwrap();
    let uncertainty = uncertainty(&tracked, &folds(4, 4), 2);
    // The bands of other objects do not use the spread, so it is given the factor of calibrated bands.
    let own = model.calibration.as_mut().unwrap();
    own.relative_std = 10.0;
    let others = uncertainty.others.unwrap();
    assert_eq!(own.floor_n_m, others.floor_n_m);
    assert_eq!(others.misfits.len(), 3, "a misfit for each held-out touch");
    field.elastic = Some(Arc::new(model));
    let mut predictor = Predictor::new(Arc::clone(&arm), &field, config().touch).unwrap();
    for again in 0..2 {
        predictor.begin_touch();
        let steps = touches[2].samples.iter().map(|sample| predictor.step(sample).unwrap());
        let predicted: Vec<_> = steps.flatten().collect();
        assert_eq!(predicted.len(), found.torques[0].len());
        for (step, wanted) in predicted.iter().zip(&found.torques[0]) {
            let off = (0..2).map(|joint| (step.predicted[joint] - wanted[joint]).abs());
            let off = off.fold(0.0, f64::max);
            assert!(off < 1e-9, "{off} N·m off in round {again}, {wanted:?}");
        }
        for (step, wanted) in predicted.iter().zip(&uncertainty.spread[0]) {
            let spread = step.spread.as_ref().unwrap();
            let off = (0..2).map(|joint| (spread[joint] - wanted[joint]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-9 * (1.0 + spread.amax()), "{off} N·m off, {spread} and {wanted:?}");
        }
        assert!(predicted.iter().any(|step| step.spread.as_ref().unwrap().amax() > 0.1));
    }
    // A path through all samples has the same bands.
    let path: Vec<&[f64]> = touches[2].samples.iter().map(|sample| &sample.q[..]).collect();
    let calibration = field.bands().unwrap().clone();
    let untouched_std = calibration.untouched_std_n_per_m;
    let paths = PathPredictor::of_field(&arm, &field, untouched_std, 1.0).unwrap();
    let mut config = PathConfig::default();
    config.resolution_cells = 0.0;
    let widths = paths.ask(&path, &config).unwrap().half_width(0.9).unwrap();
    let mut predictor = Predictor::planned(Arc::clone(&arm), &field).unwrap();
    predictor.begin_touch();
    for (sample, width) in touches[2].samples.iter().zip(&widths) {
        let step = predictor.step(sample).unwrap().unwrap();
        let (torque, spread) = (step.predicted.as_slice(), step.spread.unwrap());
        let contacts = [step.contacts, step.known];
        let wanted = calibration.half_width(0.9, torque, spread.as_slice(), contacts).unwrap();
        assert!((&wanted - width).amax() < 1e-6 * wanted.amax(), "{wanted} and {width}");
    }
}

/// The uncertainty of the estimator `elastic` in a fold.
fn uncertainty(tracked: &TrackedTouches, folds: &[Fold], fold: usize) -> Uncertainty {
    let plan = EvaluationPlan {
        methods: vec![Method::Elastic],
        folds: folds.to_vec(),
        todo: vec![fold],
        config: config(),
        estimators: vec![[config(), config()]; folds.len()],
    };
    let found = Mutex::new(None);
    let done = |part: FoldPrediction| *found.lock().unwrap() = part.uncertainty;
    plan.run(tracked, &plan.parts(), NEVER, &done).unwrap();
    found.into_inner().unwrap().unwrap()
}

#[test]
fn bands_calibrated_with_a_body_hold_what_it_does_not_explain() {
    let arm = arm();
    // Part of the torque differs from touch to touch, and is not that of the body.
    let touches: Vec<TouchSamples> = (0..10)
        .map(|number| {
            let own = f64::from(number % 5) / 5.0;
            let mut touch =
                touches(&arm, 2.0 + own, CONTACT_CANDIDATES[1][0]).remove(number as usize % 4);
            touch.samples.iter_mut().for_each(|sample| sample.tau[0] += own * sample.q[1]);
            touch
        })
        .collect();
    let learn = |learner: ElasticBodyLearner| {
        let (mut learner, samples) = (learner, touches.iter().map(|touch| touch.samples.clone()));
        learner.learn(samples, (NEVER, &|| ())).unwrap()
    };
    let learner = || ElasticBodyLearner::new(&arm, &config(), &[body()]);
    let [given, own] = [learn(learner()), learn(learner().calibrating())];
    let [others, calibration] = [&given, &own].map(|model| model.calibration.clone().unwrap());
    assert!(others.of_other_objects && !calibration.of_other_objects);
    assert_eq!((calibration.touches, calibration.misfits.len()), (10, 10));
    assert!(calibration.highest_level() == 0.9, "{calibration:?}");
    // Touches without torque do not count.
    let mut light = touches.clone();
    for sample in light[..3].iter_mut().flat_map(|touch| &mut touch.samples) {
        sample.tau.fill(0.01);
    }
    let samples = light.iter().map(|touch| touch.samples.clone());
    let few = learner().calibrating().learn(samples, (NEVER, &|| ())).unwrap();
    let few = few.calibration.unwrap();
    assert!(few.of_other_objects && few.misfits.len() == 7, "{few:?}");

    assert_eq!(
        ElasticModel { calibration: None, ..given },
        ElasticModel { calibration: None, ..own }
    );

    // In every fold, most torques of the touch left out are inside of the bands of the others.
    let tracked = TrackedTouches::new(&arm, &config(), &touches, NEVER).unwrap();
    let training: Vec<Vec<usize>> = folds(10, 10).into_iter().map(|fold| fold.train).collect();
    let tracked =
        tracked.with_bodies(&arm, &[body()], (&touches, &training), (NEVER, &|| ())).unwrap();
    let plan = EvaluationPlan {
        methods: vec![Method::Elastic],
        folds: folds(10, 10),
        todo: (0..10).collect(),
        config: config(),
        estimators: vec![[config(), config()]; 10],
    };
    let parts = Mutex::new(Vec::new());
    plan.run(&tracked, &plan.parts(), NEVER, &|part| parts.lock().unwrap().push(part)).unwrap();
    let names = vec!["along".to_owned(), "turn".to_owned()];
    let found = plan.gather(&tracked, &parts.into_inner().unwrap(), names, "measured");
    let coverage = found.methods[0].coverage.as_ref().unwrap();
    assert!(coverage.torque_share > 0.8, "{coverage:?}");
    assert!(coverage.half_width_n_m < coverage.constant_half_width_n_m, "{coverage:?}");
}

#[test]
fn touches_with_almost_no_torque_give_the_same_body_as_no_touches() {
    let arm = arm();
    let mut touches = touches(&arm, 2.0, 0.3);
    touches.iter_mut().flat_map(|touch| &mut touch.samples).for_each(|s| s.tau.fill(0.01));
    let tracked = tracked(&arm, &body(), &touches);
    let of = |touches: &[usize]| elastic::model(&tracked, touches, &config(), NEVER).unwrap();
    let [none, light] = [&[][..], &[0, 1, 2]].map(of);
    assert_eq!((none.share, &none.variants), (light.share, &light.variants));
    assert_eq!(none.torque_limit_n_m, light.torque_limit_n_m);
    assert!(none.variants[0].stiffness_factors.iter().all(|&factor| factor > 0.1));
}

#[test]
fn trees_of_different_stiffness_side_by_side_are_distinguished() {
    let arm = arm();
    // The stem in the middle is three times as stiff as the others.
    let stiffer = |segment: &Segment| Segment {
        joint_stiffness: segment.joint_stiffness * if segment.branch == 1 { 3.0 } else { 1.0 },
        ..segment.clone()
    };
    let true_body: Vec<Segment> = body().segments().iter().map(stiffer).collect();
    let true_body = Arc::new(ElasticBody::new(true_body).unwrap());
    let touches = touches_of(&true_body, &arm, 1.0, CONTACT_CANDIDATES[1][0]);
    let tracked = tracked(&arm, &body(), &touches);
    for fold in folds(4, 4) {
        let found = elastic::predict(&tracked, &fold, &config(), NEVER).unwrap();
        let factors = found.constants.by_tree().collect::<Vec<_>>();
        let [first, middle, last] = factors[..] else { panic!("{factors:?}") };
        assert!(middle > 1.8 * first && middle > 1.8 * last, "{factors:?}");
    }
}

#[test]
fn forces_depend_on_the_earlier_path_only_without_creep() {
    let arm = arm();
    // Presses the rod into the stems beside the place where it then slides to, and waits there.
    let force_from = |beside_m: f64, creep_s: f64, waits: usize| {
        let config = ElasticContactConfig { friction: 5.0, creep_s, ..Default::default() };
        let mut equilibrium = Equilibrium::new(Arc::clone(&arm), body(), config);
        let way = (0..40).map(|n| [beside_m, 0.01 * f64::from(n)]);
        let slide = (0..20).map(|n| [beside_m * (1.0 - f64::from(n) / 19.0), 0.39]);
        let mut force = 0.0;
        for (sample, q) in way.chain(slide).chain(vec![[0.0, 0.39]; waits]).enumerate() {
            let poses = arm.robot.forward(&q).unwrap();
            let passed_s = if sample < 60 { 0.0 } else { 0.05 };
            equilibrium.advance(&poses.world_from_link, Some(passed_s));
            force = equilibrium.torques(&poses).column_sum()[0];
        }
        force
    };
    let apart = |creep_s: f64, waits: usize| {
        (force_from(0.02, creep_s, waits) - force_from(-0.02, creep_s, waits)).abs()
    };
    let held = apart(0.0, 1);
    assert!(held > 0.5, "{held} N");
    assert!((apart(0.0, 50) / held - 1.0).abs() < 0.01, "{} N, {held} before", apart(0.0, 50));
    let [soon, late] = [3, 300].map(|waits| apart(1e-3, waits));
    assert!(late < 0.1 * held && late < 0.5 * soon, "{held}, {soon} and {late} N");
}

/// The body raised by this height, m.
fn raised(by_m: f64) -> Arc<ElasticBody> {
    let body = body();
    let raised = body.segments().iter().map(|segment| {
        let up = |[x, y, z]: [f64; 3]| [x, y, z + by_m];
        let (start_m, end_m) = (up(segment.start_m), up(segment.end_m));
        Segment { start_m, end_m, ..segment.clone() }
    });
    Arc::new(ElasticBody::new(raised.collect()).unwrap())
}

#[test]
fn touches_learnt_one_by_one_give_the_body_of_all_at_once_and_old_ones_are_forgotten() {
    let arm = arm();
    let samples: Vec<Vec<Sample>> = touches(&arm, 2.0, CONTACT_CANDIDATES[1][0])
        .into_iter()
        .map(|touch| touch.samples)
        .collect();
    let bodies = [body(), raised(0.05)];
    let quietly: (_, &(dyn Fn() + Sync)) = (NEVER, &|| ());
    let begin = || ElasticBodyLearner::new(&arm, &config(), &bodies);
    let at_once = |touches: &[Vec<Sample>]| begin().learn(touches.to_vec(), quietly).unwrap();
    let mut learner = begin();
    for samples in &samples {
        learner.learn([samples.clone()], quietly).unwrap();
    }
    let all = learner.learn([], quietly).unwrap();
    assert_eq!(all, at_once(&samples));
    assert!(all.variants[0].weight > 0.5 && all.variants[1].weight > 1e-6, "both were simulated");
    learner.forget_all_but(2);
    let newest = learner.learn([samples[0].clone()], quietly).unwrap();
    let wanted = [&samples[2], &samples[3], &samples[0]].map(Clone::clone);
    assert_eq!(newest, at_once(&wanted));

    let mut broken = samples[1].clone();
    broken[20].tau.pop();
    let error = learner.learn([broken], quietly).unwrap_err().to_string();
    assert!(error.contains("20"), "{error}");
    assert_eq!(learner.learn([], quietly).unwrap(), newest, "nothing is lost");
}

#[test]
fn a_material_that_no_touch_reached_keeps_its_prior_stiffness() {
    let arm = arm();
    // Two blocks, one of them behind the rod.
    let block = |(material, [x, y]): (u32, [f64; 2])| Segment {
        parent: None,
        kind: SegmentKind::Block,
        start_m: [x - 0.02, y, 0.0],
        end_m: [x + 0.02, y, 0.0],
        bare_m: 0.0,
        radius_m: 0.02,
        half_width_m: [0.0, 0.02, 0.0],
        joint_stiffness: 100.0,
        branch: material,
    };
    let blocks = [(0, [0.25, 0.1]), (1, [0.25, -0.4])].map(block);
    let body = Arc::new(ElasticBody::new(blocks.to_vec()).unwrap());
    let factors = |touches: &[TouchSamples]| {
        let samples = touches.iter().map(|touch| touch.samples.clone());
        let mut learner = ElasticBodyLearner::new(&arm, &config(), std::slice::from_ref(&body));
        let model = learner.learn(samples, (NEVER, &|| ())).unwrap();
        model.variants[0].stiffness_factors.clone()
    };
    let untouched = factors(&[]);
    let touched = factors(&touches_of(&body, &arm, 2.0, CONTACT_CANDIDATES[1][0])[..1]);
    assert!((touched[0] / 2.0).ln().abs() < 0.1, "{touched:?}, wanted 2");
    assert_eq!(touched[1], untouched[1]);
}

#[test]
fn a_path_bends_the_body_as_the_same_motion_does_step_by_step() {
    let arm = arm();
    let touches = touches(&arm, 2.0, CONTACT_CANDIDATES[4][0]);
    let samples = touches[..3].iter().map(|touch| touch.samples.clone());
    let model = ElasticBodyLearner::new(&arm, &config(), &[body()]).learn(samples, (NEVER, &|| ()));
    let model = model.unwrap();
    let mut mapper = Mapper::new(Arc::clone(&arm), config()).unwrap();
    let mut bent = ElasticTorque::new(&arm, &model);
    let (before, after) = touches[3].samples.split_at(30);
    for touch in [&touches[0].samples[..], before] {
        mapper.begin_touch();
        bent.begin_touch();
        for sample in touch {
            mapper.step(sample).unwrap();
            bent.advance(&arm.robot.forward(&sample.q).unwrap(), None);
        }
    }
    let mut field = mapper.field();
    field.elastic = Some(Arc::new(model.clone()));
    let mut predictor = Predictor::planned(Arc::clone(&arm), &field).unwrap();
    predictor.begin_touch();
    let steps = touches[3].samples.iter().map(|sample| predictor.step(sample).unwrap().unwrap());
    let steps: Vec<_> = steps.map(|step| step.predicted).collect();
    let peak = steps.iter().map(|torque| torque.norm()).fold(0.0, f64::max);
    let path = |samples: &[Sample]| samples.iter().map(|s| s.q.clone()).collect::<Vec<_>>();
    let exact = PathConfig::new(0.0, 1.0);
    let springs = mapper.path_predictor().ask(&path(after), &exact).unwrap();
    let asked = mapper.path_predictor().with_body(&model, bent);
    for (samples, steps, goes_on) in
        [(after, &steps[30..], true), (&touches[3].samples[..], &steps[..], false)]
    {
        let found = asked.ask(&path(samples), &exact).unwrap();
        assert_eq!(found.goes_on, goes_on);
        for (point, step) in found.points.iter().zip(steps) {
            let off = (&point.torque - step).norm();
            assert!(off < 0.01 * peak, "{} N·m, step by step {step}", point.torque);
        }
    }
    // A saved field contains the body, and gives the same torques.
    let of_field = PathPredictor::of_field(&arm, &field, 1.0, 1.0).unwrap();
    let found = of_field.ask(&path(&touches[3].samples), &exact).unwrap();
    for (point, step) in found.points.iter().zip(&steps) {
        assert!((&point.torque - step).norm() < 0.01 * peak, "{} N·m, {step}", point.torque);
    }
    let [body, springs] = [&steps[47], &springs.points.last().unwrap().torque];
    assert!((body - springs).norm() > 0.1 * peak, "{body}, springs alone {springs}");
}

#[test]
fn a_body_that_no_touch_reaches_has_almost_no_weight() {
    let arm = arm();
    let touches = touches(&arm, 1.0, 0.3);
    // A bush above the plane in which the rod moves.
    let elsewhere = raised(0.6);
    let tracked = tracked(&arm, &elsewhere, &touches);
    let fold = &folds(4, 4)[3];
    let found = elastic::predict(&tracked, fold, &config(), NEVER).unwrap();
    let map = palpate_learn::method::Method::Map.predict(&tracked, fold, &config(), NEVER).unwrap();
    assert!(found.weights.body < 0.05, "{:?}", found.weights);
    for (torque, map) in found.torques[0].iter().zip(&map[0]) {
        assert!((torque[1] - map[1]).abs() <= 0.05 * map[1].abs() + 1e-9, "{torque:?}, {map:?}");
    }
}

#[test]
fn a_body_that_would_have_to_be_far_stiffer_gets_no_stiffness_even_after_one_touch() {
    let arm = arm();
    let touches = touches(&arm, 100.0, 0.4);
    let tracked = tracked(&arm, &body(), &touches);
    let mut fold = folds(4, 4)[3].clone();
    fold.train.truncate(1);
    let found = elastic::predict(&tracked, &fold, &config(), NEVER).unwrap();
    let map =
        palpate_learn::method::Method::Map.predict(&tracked, &fold, &config(), NEVER).unwrap();
    assert_eq!(found.constants.stiffness_factor(), 0.0);
    for (torque, map) in found.torques[0].iter().zip(&map[0]) {
        // The weight of the body alone, whose torque is zero, reduces the prediction.
        assert!(torque[1].abs() <= map[1].abs() + 1e-9, "{torque:?}, {map:?}");
    }
}

#[test]
fn a_clock_that_goes_back_or_gives_no_number_counts_as_no_time() {
    let arm = arm();
    let torques = |time_s: f64| {
        let config = ElasticContactConfig { creep_s: 1e-2, ..Default::default() };
        let mut equilibrium = Equilibrium::new(Arc::clone(&arm), body(), config);
        let mut torques = Vec::new();
        for n in 0..40 {
            let poses = arm.robot.forward(&[0.001 * f64::from(n), 0.01 * f64::from(n)]).unwrap();
            equilibrium.advance(&poses.world_from_link, Some(time_s));
            torques.push(equilibrium.torques(&poses));
        }
        torques
    };
    let still = torques(0.0);
    assert!(still[39].norm() > 0.5 && still != torques(0.05), "creep matters here");
    for time_s in [-1.0, f64::NAN, f64::NEG_INFINITY] {
        assert_eq!(torques(time_s), still, "{time_s} s");
    }
}
