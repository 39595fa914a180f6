//! The cell's messages over Unix sockets with bincode, to compare the bus with.
//!
//! It is made to be as fast as that can be: one datagram a message, so that nobody puts frames together; only the part
//! of a message that is in use; a body of plain bytes, which bincode copies as a whole; every buffer kept.

use std::io;
use std::mem::offset_of;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::Duration;

use bincode::config::{Configuration, Fixint, LittleEndian};
use messages::{Belief, BoxQueue, CandidateSet, Decision, Message, MotionReport, PlaceCommand};

/// Largest frame: a belief and what stands before it [bytes].
const FRAME_BYTES_MAX: usize = size_of::<Belief>() + 64;

/// How long a reader waits for a message before it takes its peer for dead.
const PATIENCE: Duration = Duration::from_secs(5);

const FORMAT: Configuration<LittleEndian, Fixint> = bincode::config::legacy();

/// A message that crosses a socket.
pub trait Sent: Message {
    /// Tells the messages apart.
    const KIND: u8;

    /// How many of its bytes mean something.
    fn used_bytes(&self) -> usize {
        size_of::<Self>()
    }
}

impl Sent for Belief {
    const KIND: u8 = 0;

    fn used_bytes(&self) -> usize {
        let cells = usize::from(self.slot_count) * usize::from(self.length) * usize::from(self.breadth);
        (offset_of!(Self, heights) + 2 * cells).min(size_of::<Self>())
    }
}

impl Sent for BoxQueue {
    const KIND: u8 = 1;
}

impl Sent for CandidateSet {
    const KIND: u8 = 2;

    fn used_bytes(&self) -> usize {
        (offset_of!(Self, candidates) + 16 * self.count as usize).min(size_of::<Self>())
    }
}

impl Sent for Decision {
    const KIND: u8 = 3;
}

impl Sent for PlaceCommand {
    const KIND: u8 = 4;
}

impl Sent for MotionReport {
    const KIND: u8 = 5;
}

/// What lies in a datagram.
#[derive(bincode::Encode, bincode::BorrowDecode)]
struct Frame<'a> {
    kind: u8,
    stages_ns: [u64; 3],
    body: &'a [u8],
}

/// Where one process receives.
#[derive(Debug)]
pub struct Inbox {
    socket: UnixDatagram,
    frame: Vec<u8>,
    length: usize,
}

/// The way to another process. Each has a socket of its own, so that one that is slow holds up no other.
#[derive(Debug)]
pub struct Outbox {
    socket: UnixDatagram,
    frame: Vec<u8>,
}

/// A datagram that is none of ours.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// The operating system refused, or nothing came in time.
    #[error("the socket {0}")]
    Io(PathBuf, #[source] io::Error),
    /// It cannot be read.
    #[error("a datagram that is no message")]
    Decode(#[from] bincode::error::DecodeError),
    /// It cannot be written.
    #[error("a message that makes no datagram")]
    Encode(#[from] bincode::error::EncodeError),
}

/// The socket of the process called `name`.
#[must_use]
pub fn path_of(dir: &Path, name: &str) -> PathBuf {
    dir.join(format!("{name}.sock"))
}

impl Inbox {
    /// Receives as `name`.
    ///
    /// # Errors
    /// [`SocketError::Io`] if the socket exists already or the directory does not.
    pub fn bind(dir: &Path, name: &str) -> Result<Self, SocketError> {
        let path = path_of(dir, name);
        let socket = UnixDatagram::bind(&path).map_err(|error| SocketError::Io(path, error))?;
        Ok(Self { socket, frame: vec![0; FRAME_BYTES_MAX], length: 0 })
    }

    /// Gives up waiting after some seconds of silence.
    ///
    /// # Errors
    /// [`SocketError::Io`].
    pub fn wait_with_patience(&self) -> Result<(), SocketError> {
        self.socket.set_read_timeout(Some(PATIENCE)).map_err(|error| SocketError::Io("timeout".into(), error))
    }

    /// Sleeps until the next message, and says of which kind it is.
    ///
    /// # Errors
    /// [`SocketError`] if nothing came in time or it is no message.
    pub fn receive(&mut self) -> Result<u8, SocketError> {
        self.length = self.socket.recv(&mut self.frame).map_err(|error| SocketError::Io("inbox".into(), error))?;
        Ok(self.frame()?.kind)
    }

    /// Copies the message that was received last.
    ///
    /// # Errors
    /// [`SocketError::Decode`] if it is none.
    pub fn read<M: Sent>(&self, message: &mut M) -> Result<(), SocketError> {
        let frame = self.frame()?;
        let bytes = bytemuck::bytes_of_mut(message);
        let used = frame.body.len().min(bytes.len());
        bytes[..used].copy_from_slice(&frame.body[..used]);
        Ok(())
    }

    /// The times that came with it [ns].
    ///
    /// # Errors
    /// [`SocketError::Decode`] if it is no message.
    pub fn stages_ns(&self) -> Result<[u64; 3], SocketError> {
        Ok(self.frame()?.stages_ns)
    }

    fn frame(&self) -> Result<Frame<'_>, SocketError> {
        Ok(bincode::borrow_decode_from_slice(&self.frame[..self.length], FORMAT)?.0)
    }
}

impl Outbox {
    /// The way to `name`, who must be receiving.
    ///
    /// # Errors
    /// [`SocketError::Io`] if nobody does.
    pub fn to(dir: &Path, name: &str) -> Result<Self, SocketError> {
        let path = path_of(dir, name);
        let connect = || {
            let socket = UnixDatagram::unbound()?;
            socket.connect(&path)?;
            Ok(socket)
        };
        let socket = connect().map_err(|error| SocketError::Io(path.clone(), error))?;
        Ok(Self { socket, frame: vec![0; FRAME_BYTES_MAX] })
    }

    /// Sends a message.
    ///
    /// # Errors
    /// [`SocketError`] if it cannot be sent.
    pub fn send<M: Sent>(&mut self, message: &M) -> Result<(), SocketError> {
        self.send_timed(message, [0; 3])
    }

    /// Sends a message with the times of three stages [ns].
    ///
    /// # Errors
    /// [`SocketError`] if it cannot be sent.
    pub fn send_timed<M: Sent>(&mut self, message: &M, stages_ns: [u64; 3]) -> Result<(), SocketError> {
        let body = &bytemuck::bytes_of(message)[..message.used_bytes()];
        let length = bincode::encode_into_slice(Frame { kind: M::KIND, stages_ns, body }, &mut self.frame, FORMAT)?;
        self.socket.send(&self.frame[..length]).map_err(|error| SocketError::Io("outbox".into(), error))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use packing::{BoxSpec, ContainerSize, Grid, Placement, Yaw};

    use super::*;

    #[test]
    fn what_is_used_of_a_message_arrives() {
        let dir = tempfile::tempdir().unwrap();
        let mut inbox = Inbox::bind(dir.path(), "one").unwrap();
        let mut outbox = Outbox::to(dir.path(), "one").unwrap();
        let mut grid = Grid::new(ContainerSize::PAPER, 16).unwrap();
        let place = Placement { slot: 15, yaw: Yaw::Deg0, i: 25, j: 50, base: 0 };
        grid.place(&BoxSpec::new(1, [200, 300, 100]).unwrap(), place).unwrap();
        let mut sent: Box<Belief> = Box::new(Zeroable::zeroed());
        sent.write(&grid);
        let mut received: Box<Belief> = Box::new(Zeroable::zeroed());
        outbox.send_timed(&*sent, [1, 2, 3]).unwrap();
        assert_eq!(inbox.receive().unwrap(), Belief::KIND);
        inbox.read(&mut *received).unwrap();
        assert_eq!(inbox.stages_ns().unwrap(), [1, 2, 3]);
        assert_eq!(bytemuck::bytes_of(&*received), bytemuck::bytes_of(&*sent));
        assert!(sent.used_bytes() < size_of::<Belief>());
    }

    #[test]
    fn nobody_to_send_to_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let message = Outbox::to(dir.path(), "nobody").unwrap_err().to_string();
        assert!(message.contains("nobody.sock"), "{message}");
    }
}
