//! The bytes of an `.rrd` file.
//!
//! Rerun's own file sink writes on a thread of its own and only logs what goes wrong there. Here
//! Rerun gathers messages in memory, and whoever records takes them out and encodes them: a full
//! disk is an error of the call that met it.

use std::io::Write;

use re_log_encoding::{CrateVersion, EncodeError, Encoder, EncodingOptions};
use re_sdk::sink::MemorySinkStorage;

use crate::recording::ViewError;

/// Samples that are gathered before they are written: a few megabytes.
const ROWS: u32 = 128;

/// A file under way.
pub(crate) struct Rrd<'out> {
    messages: MemorySinkStorage,
    encoder: Encoder<&'out mut dyn Write>,
    rows: u32,
}

impl<'out> Rrd<'out> {
    /// Writes the file's head.
    pub(crate) fn begin(
        messages: MemorySinkStorage,
        out: &'out mut dyn Write,
    ) -> Result<Self, ViewError> {
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(CrateVersion::LOCAL, options, out)?;
        Ok(Self { messages, encoder, rows: 0 })
    }

    /// Counts a sample; with enough of them, writes.
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

    /// Writes what is left, and the file's end.
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
