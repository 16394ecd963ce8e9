//! A queue between two threads that never blocks the producer.
//!
//! Its capacity is fixed: if the consumer is slow, the oldest items are dropped and counted. The
//! newest are kept, since the present state of the robot matters most.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use crate::threads::lock;

/// A bounded queue that keeps the newest items.
#[derive(Debug)]
pub struct LatestQueue<T> {
    queue: Mutex<Queue<T>>,
    filled: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct Queue<T> {
    items: VecDeque<T>,
    dropped: u64,
    woken: bool,
}

impl<T> LatestQueue<T> {
    /// An empty queue; a capacity of 0 is taken as 1.
    pub fn new(capacity: usize) -> Self {
        let queue = Mutex::new(Queue { items: VecDeque::new(), dropped: 0, woken: false });
        Self { queue, filled: Condvar::new(), capacity: capacity.max(1) }
    }

    /// Adds an item; drops the oldest one if the queue is full.
    pub fn push(&self, item: T) {
        let mut queue = lock(&self.queue);
        if queue.items.len() >= self.capacity {
            queue.items.pop_front();
            queue.dropped += 1;
        }
        queue.items.push_back(item);
        drop(queue);
        self.filled.notify_one();
    }

    /// Removes the oldest item; waits for one for at most `patience`, or until [`LatestQueue::wake`] is
    /// called.
    pub fn pop(&self, patience: Duration) -> Option<T> {
        let queue = lock(&self.queue);
        let nothing = |queue: &mut Queue<T>| queue.items.is_empty() && !queue.woken;
        let waited = self.filled.wait_timeout_while(queue, patience, nothing);
        let (mut queue, _) = waited.unwrap_or_else(PoisonError::into_inner);
        queue.woken = false;
        queue.items.pop_front()
    }

    /// Ends the present or the next wait in [`LatestQueue::pop`] early.
    pub fn wake(&self) {
        lock(&self.queue).woken = true;
        self.filled.notify_one();
    }

    /// Number of items that wait.
    pub fn len(&self) -> usize {
        lock(&self.queue).items.len()
    }

    /// Whether no item waits.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of items dropped so far.
    pub fn dropped(&self) -> u64 {
        lock(&self.queue).dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::thread;

    #[test]
    fn the_newest_are_kept_in_order_and_the_others_counted() {
        let queue = LatestQueue::new(3);
        (0..10).for_each(|item| queue.push(item));
        let kept: Vec<_> = std::iter::from_fn(|| queue.pop(Duration::ZERO)).collect();
        assert_eq!((kept, queue.dropped(), queue.is_empty()), (vec![7, 8, 9], 7, true));
    }

    #[test]
    fn what_one_thread_pushes_another_gets_and_nothing_is_lost_below_capacity() {
        let queue = Arc::new(LatestQueue::new(1000));
        let producer = Arc::clone(&queue);
        let thread = thread::spawn(move || (0..1000).for_each(|item| producer.push(item)));
        let got: Vec<_> = (0..1000).map(|_| queue.pop(Duration::from_secs(180))).collect();
        thread.join().unwrap();
        assert_eq!(got, (0..1000).map(Some).collect::<Vec<_>>());
        assert_eq!(queue.dropped(), 0);
    }

    #[test]
    fn a_wait_ends_after_its_time_and_when_it_is_woken() {
        let queue = Arc::new(LatestQueue::<()>::new(1));
        assert_eq!(queue.pop(Duration::from_millis(1)), None);
        let waking = Arc::clone(&queue);
        let thread = thread::spawn(move || waking.wake());
        assert_eq!(queue.pop(Duration::MAX), None);
        thread.join().unwrap();
        queue.push(());
        queue.wake();
        assert_eq!(queue.pop(Duration::MAX), Some(()));
    }
}
