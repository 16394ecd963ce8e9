//! Replays beside the simulator, on a second thread.
//!
//! A step that touches little lasts some fifty microseconds, about as long as a sleeping thread
//! takes to wake. So the second thread is the mapper's own, and both sides look out for each other
//! for a while before they sleep. If the machine is too busy for the second thread to have begun
//! when the work beside it is done, the mapper takes the replays back. Within a thread pool no
//! thread is added: whoever shares out the pool's threads has better use for them, and rayon
//! decides whether one is free.

use std::hint::spin_loop;
use std::ops::{Deref, DerefMut};
use std::thread;

use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded};

use crate::estimator::Estimator;

/// Looks for the other side before sleeping: about a tenth of a millisecond.
const LOOKS: u32 = 5_000;

/// An estimator whose replays can be made while other work is done.
pub(crate) struct Replayer {
    /// `None` only while the second thread has it.
    estimator: Option<Box<dyn Estimator>>,
    second: Second,
}

/// The second thread.
enum Second {
    NotStarted,
    /// The system has none to spare.
    Refused,
    Started {
        replay: Sender<Job>,
        /// Where the thread takes what was sent, unless it is taken back before.
        waiting: Receiver<Job>,
        replayed: Receiver<Job>,
    },
}

/// An estimator and the visits that it is to make.
type Job = (Box<dyn Estimator>, u32);

impl Replayer {
    pub(crate) fn new(estimator: Box<dyn Estimator>) -> Self {
        Self { estimator: Some(estimator), second: Second::NotStarted }
    }

    /// Makes the visits and runs `work` meanwhile: after both, whatever the threads, the estimator
    /// is the same to the bit.
    pub(crate) fn replay_beside<T: Send>(
        &mut self,
        visits: u32,
        work: impl FnOnce() -> T + Send,
    ) -> T {
        if rayon::current_thread_index().is_some() {
            return rayon::join(work, || self.replay(visits)).0;
        }
        if matches!(self.second, Second::NotStarted) && rayon::current_num_threads() > 1 {
            self.second = Second::start();
        }
        let Second::Started { replay, waiting, replayed } = &self.second else {
            self.replay(visits);
            return work();
        };
        let estimator = self.estimator.take().expect(HERE);
        replay.send((estimator, visits)).expect(PANICKED);
        let done = work();
        let estimator = match waiting.try_recv() {
            Ok((mut estimator, visits)) => {
                estimator.replay(visits);
                estimator
            }
            Err(_) => receive(replayed).expect(PANICKED).0,
        };
        self.estimator = Some(estimator);
        done
    }
}

const HERE: &str = "the estimator is away only while it replays";
const PANICKED: &str = "the second thread ends only with the replayer, or by a panic of its own";

impl Deref for Replayer {
    type Target = dyn Estimator;

    fn deref(&self) -> &Self::Target {
        self.estimator.as_deref().expect(HERE)
    }
}

impl DerefMut for Replayer {
    fn deref_mut(&mut self) -> &mut Self::Target {
        self.estimator.as_deref_mut().expect(HERE)
    }
}

impl Second {
    /// Starts the thread; it ends when the replayer is dropped.
    fn start() -> Self {
        let (replay, waiting) = bounded::<Job>(1);
        let (done, replayed) = bounded(1);
        let jobs = waiting.clone();
        let serve = move || {
            while let Some((mut estimator, visits)) = receive(&jobs) {
                estimator.replay(visits);
                if done.send((estimator, visits)).is_err() {
                    break;
                }
            }
        };
        match thread::Builder::new().name("palpate-replay".to_owned()).spawn(serve) {
            Ok(_) => Self::Started { replay, waiting, replayed },
            Err(_) => Self::Refused,
        }
    }
}

/// What the other side sends next; `None` once it is gone.
fn receive<T>(from: &Receiver<T>) -> Option<T> {
    for _ in 0..LOOKS {
        match from.try_recv() {
            Ok(sent) => return Some(sent),
            Err(TryRecvError::Disconnected) => return None,
            Err(TryRecvError::Empty) => spin_loop(),
        }
    }
    from.recv().ok()
}
