//! Runs every target on mutated seeds for `PALPATE_FUZZ_SECONDS` seconds each, or without it on a
//! few hundred inputs each.

use std::env;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use palpate_fuzz::{Mutator, TARGETS, Target};

const FEW: usize = 300;
/// Largest time for one input; a longer time is a failure.
const HANG: Duration = Duration::from_secs(5);
/// Number of targets that run at the same time.
const THREADS: usize = 2;

/// Runs a target; returns the number of inputs, or an error with the input that failed.
fn fuzz(target: &Target, seconds: Option<f64>) -> Result<usize, String> {
    let seeds = (target.seeds)();
    let mut mutator = Mutator::new(seeds.clone(), 1);
    let (begun, mut inputs) = (Instant::now(), 0);
    let mut next = seeds.into_iter();
    loop {
        let done = match seconds {
            Some(seconds) => begun.elapsed().as_secs_f64() > seconds,
            None => inputs >= FEW,
        };
        if done {
            return Ok(inputs);
        }
        let input = next.next().unwrap_or_else(|| mutator.next_input());
        let started = Instant::now();
        let panicked = catch_unwind(AssertUnwindSafe(|| (target.run)(&input))).is_err();
        let fault = match (panicked, started.elapsed()) {
            (true, _) => "panics".to_owned(),
            (false, took) if took > HANG => format!("takes {took:?}"),
            _ => String::new(),
        };
        if !fault.is_empty() {
            let kept = env::temp_dir().join(format!("palpate-fuzz-{}", target.name));
            let file_or_input = std::fs::write(&kept, &input)
                .map_or_else(|_| format!("{input:?}"), |()| kept.display().to_string());
            return Err(format!("{} {fault} at input {inputs}: {file_or_input}", target.name));
        }
        inputs += 1;
    }
}

#[test]
fn no_target_panics_or_hangs() {
    let seconds = env::var("PALPATE_FUZZ_SECONDS").ok().map(|s| s.parse().expect("seconds"));
    let next = AtomicUsize::new(0);
    let take = || TARGETS.get(next.fetch_add(1, Ordering::Relaxed));
    let faults: Vec<String> = thread::scope(|scope| {
        let work = || {
            let mut faults = Vec::new();
            while let Some(target) = take() {
                match fuzz(target, seconds) {
                    Ok(inputs) => println!("{:12} {inputs} inputs", target.name),
                    Err(fault) => faults.push(fault),
                }
            }
            faults
        };
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("caught")).collect()
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_same_random_seed_gives_the_same_inputs() {
    let inputs = |seed| {
        let mut mutator = Mutator::new(vec![b"some bytes".to_vec()], seed);
        (0..100).map(|_| mutator.next_input()).collect::<Vec<_>>()
    };
    assert_eq!(inputs(1), inputs(1));
    assert_ne!(inputs(1), inputs(2));
}
