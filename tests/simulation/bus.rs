//! A bus of the mind: queues that drop their oldest message when they are full, and a last word that is kept for
//! whoever comes late as long as its publisher lives. What the real bus may do to a reader, this one does.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use bytemuck::Zeroable;
use messages::{Header, Message};

/// Memory of messages that nobody reads any more, to build the next ones in.
#[derive(Debug)]
pub(crate) struct Pool<M>(Rc<RefCell<Vec<Box<M>>>>);

/// A published message.
#[derive(Debug)]
pub(crate) struct Sample<M> {
    message: Option<Box<M>>,
    pool: Rc<RefCell<Vec<Box<M>>>>,
}

/// One topic with its readers.
#[derive(Debug)]
pub(crate) struct Topic<M> {
    pool: Pool<M>,
    queues: Vec<VecDeque<Rc<Sample<M>>>>,
    depth: usize,
    /// The last word of each living publisher.
    last: Vec<(u64, Rc<Sample<M>>)>,
}

impl<M> Drop for Sample<M> {
    fn drop(&mut self) {
        if let Some(message) = self.message.take() {
            self.pool.borrow_mut().push(message);
        }
    }
}

impl<M> Sample<M> {
    pub(crate) fn get(&self) -> &M {
        self.message.as_ref().expect("a sample has its message until it is dropped")
    }
}

impl<M: Message> Topic<M> {
    /// A topic with so many readers, each of which keeps so many messages.
    pub(crate) fn new(pool: &Pool<M>, readers: usize, depth: usize) -> Self {
        let queues = (0..readers).map(|_| VecDeque::new()).collect();
        Self { pool: Pool(Rc::clone(&pool.0)), queues, depth, last: Vec::new() }
    }

    /// Builds a message and gives it to all readers.
    pub(crate) fn publish(&mut self, header: Header, build: impl FnOnce(&mut M)) {
        let kept = self.pool.0.borrow_mut().pop();
        let mut message = kept.unwrap_or_else(|| Box::new(M::zeroed()));
        build(&mut message);
        *message.header_mut() = header;
        let sample = Rc::new(Sample { message: Some(message), pool: Rc::clone(&self.pool.0) });
        for queue in &mut self.queues {
            if queue.len() == self.depth {
                queue.pop_front();
            }
            queue.push_back(Rc::clone(&sample));
        }
        self.last.retain(|(publisher, _)| *publisher != header.publisher);
        self.last.push((header.publisher, sample));
    }

    pub(crate) fn receive(&mut self, reader: usize) -> Option<Rc<Sample<M>>> {
        self.queues[reader].pop_front()
    }

    /// The newest message that waits; those before it are skipped.
    pub(crate) fn newest(&mut self, reader: usize) -> Option<Rc<Sample<M>>> {
        self.queues[reader].drain(..).next_back()
    }

    /// A reader begins anew, and is given the last word of whoever lives.
    pub(crate) fn rejoin(&mut self, reader: usize) {
        self.queues[reader] = self.last.iter().map(|(_, sample)| Rc::clone(sample)).collect();
    }

    /// A publisher is dead; what it said to those who listened stays said.
    pub(crate) fn bury(&mut self, publisher: u64) {
        self.last.retain(|(dead, _)| *dead != publisher);
    }
}

impl<M: Zeroable> Pool<M> {
    pub(crate) fn new() -> Self {
        Self(Rc::default())
    }
}
