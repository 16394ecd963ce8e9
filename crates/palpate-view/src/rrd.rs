//! Writes `.rrd` files.
//!
//! Rerun's own file sink writes on a separate thread and only logs errors. Here Rerun collects
//! messages in memory, and the recording thread encodes and writes them: so the call that writes to
//! a full disk returns the error.

use std::io::Write;

use re_log_encoding::{CrateVersion, EncodeError, Encoder, EncodingOptions};
use re_sdk::sink::MemorySinkStorage;

use crate::recording::ViewError;

/// Number of samples collected before they are written: a few megabytes.
const ROWS: u32 = 128;

/// A file under way.
pub(crate) struct Rrd<'out> {
    messages: MemorySinkStorage,
    encoder: Encoder<&'out mut dyn Write>,
    rows: u32,
}

impl<'out> Rrd<'out> {
    /// Writes the header of the file.
    pub(crate) fn begin(
        messages: MemorySinkStorage,
        out: &'out mut dyn Write,
    ) -> Result<Self, ViewError> {
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(CrateVersion::LOCAL, options, out)?;
        Ok(Self { messages, encoder, rows: 0 })
    }

    /// Counts a sample; every [`ROWS`] samples, writes.
    pub(crate) fn row(&mut self) -> Result<(), ViewError> {
        self.rows += 1;
        if self.rows >= ROWS { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> Result<(), ViewError> {
        self.rows = 0;
        for message in self.messages.take() {
            self.encoder.append(&message)?;
        }
        Ok(())
    }

    /// Writes the remaining messages and the end of the file.
    pub(crate) fn finish(mut self) -> Result<(), ViewError> {
        self.write()?;
        self.encoder.finish()?;
        Ok(self.encoder.flush_blocking()?)
    }
}

impl From<EncodeError> for ViewError {
    fn from(error: EncodeError) -> Self {
        match error {
            EncodeError::Write(source) => Self::Write(source),
            other => Self::Record(Box::new(other)),
        }
    }
}
