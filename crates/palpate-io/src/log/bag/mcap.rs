//! Reads one MCAP file: its topics, and the messages of some of them, chunk by chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use ::mcap::read::ChannelAccumulator;
use ::mcap::records::{MessageHeader, Record, Statistics, op};
use ::mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use ::mcap::{Channel, McapError, parse_record};

use super::topic::{Message, Messages, Topic, TopicRole, merge};
use crate::{input, not_built, panics};

/// Largest size of a record, bytes; usually 256 MiB, an image of a hundred megapixels.
fn largest_record() -> usize {
    usize::try_from(input::largest() / 4).unwrap_or(usize::MAX)
}

/// The topics of a file: from its summary or, if that is missing or incomplete, from all messages.
/// The error is the end of a message.
pub(super) fn topics(path: &Path) -> Result<Vec<Topic>, String> {
    let mut file = open(path)?;
    if let Some(topics) = of_summary(&mut file).ok().flatten().filter(|topics| !topics.is_empty()) {
        return Ok(topics);
    }
    let mut topics = Vec::new();
    let mut records = Records::of_data(open(path)?);
    while let Some(message) = records.next_message().transpose() {
        match message {
            Ok(message) => merge(&mut topics, vec![topic(&message.channel, Some(1))]),
            // The part before a break can be read; reading the messages reports the break again.
            Err(_) if !topics.is_empty() => break,
            Err(why) => return Err(why),
        }
    }
    Ok(topics)
}

/// The messages of a file on the wanted topics (samples, markers). The error is the end of a message.
pub(super) fn messages(path: &Path, wanted: [Option<String>; 2]) -> Result<Messages, String> {
    let wanted_one = move |message: Result<Logged, String>| {
        let message = match message {
            Ok(message) => message,
            Err(why) => return Some(Err(why)),
        };
        let topic = Some(&message.channel.topic);
        let which = match &wanted {
            [samples, _] if samples.as_ref() == topic => TopicRole::Sample,
            [_, markers] if markers.as_ref() == topic => TopicRole::Marker,
            _ => return None,
        };
        let time_ns = i64::try_from(message.header.log_time).unwrap_or(i64::MAX);
        Some(Ok(Message { which, time_ns, data: message.data }))
    };
    let mut records = Records::of_data(open(path)?);
    let all = std::iter::from_fn(move || records.next_message().transpose());
    Ok(Box::new(all.filter_map(wanted_one)))
}

fn open(path: &Path) -> Result<File, String> {
    input::open(path).map_err(|error| in_words(&error.into()))
}

/// Describes an error, as the end of a message to the user.
fn in_words(error: &McapError) -> String {
    match error {
        McapError::UnexpectedEof | McapError::UnexpectedEoc => {
            "the file ends in the middle of a record (was the recording, or a copy of it, cut short?)"
                .to_owned()
        }
        McapError::UnsupportedCompression(packing) if !cfg!(feature = "formats") => {
            not_built(&format!("`{packing}`, the compression of its chunks"))
        }
        McapError::BadMagic => "it does not begin or end as an MCAP file does".to_owned(),
        other => match std::error::Error::source(other) {
            Some(cause) => format!("{other}: {cause}"),
            None => other.to_string(),
        },
    }
}

/// A message with its channel.
struct Logged {
    channel: Arc<Channel<'static>>,
    header: MessageHeader,
    data: Vec<u8>,
}

/// The records of a file. The library's own reader of messages is not used: it allocates the length
/// that a string claims, up to 4 GiB, before it reads the string.
struct Records {
    source: BufReader<File>,
    /// `None` after an error or the end.
    reader: Option<LinearReader>,
    known: ChannelAccumulator<'static>,
}

impl Records {
    /// Records from the start of a file.
    fn of_data(file: File) -> Self {
        Self::new(file, LinearReaderOptions::default().with_validate_chunk_crcs(true))
    }

    fn new(file: File, options: LinearReaderOptions) -> Self {
        let options = options.with_record_length_limit(largest_record());
        let reader = Some(LinearReader::new_with_options(options));
        Self { source: BufReader::new(file), reader, known: ChannelAccumulator::default() }
    }

    /// The next message, or `None` at the end. The error is the end of a message to the user.
    fn next_message(&mut self) -> Result<Option<Logged>, String> {
        loop {
            match self.next()? {
                Some(Record::Message { header, data }) => {
                    let channel = self.known.get(header.channel_id).ok_or_else(|| {
                        in_words(&McapError::UnknownChannel(header.sequence, header.channel_id))
                    })?;
                    return Ok(Some(Logged { channel, header, data: data.into_owned() }));
                }
                Some(_) => {}
                None => return Ok(None),
            }
        }
    }

    /// The next schema, channel, message or statistics; schemas and channels are added to `known`. A panic of the
    /// library, where lengths contradict each other, becomes an error. After an error, no more records are returned.
    fn next(&mut self) -> Result<Option<Record<'static>>, String> {
        let Some(mut reader) = self.reader.take() else { return Ok(None) };
        let next = panics::caught(|| self.next_of(&mut reader)).and_then(|next| next);
        if let Ok(Some(_)) = next {
            self.reader = Some(reader);
        }
        next
    }

    fn next_of(&mut self, reader: &mut LinearReader) -> Result<Option<Record<'static>>, String> {
        while let Some(event) = reader.next_event() {
            match event.map_err(|error| in_words(&error))? {
                LinearReadEvent::ReadRequest(bytes) => {
                    let read = self.source.read(reader.insert(bytes));
                    reader.notify_read(read.map_err(|error| in_words(&error.into()))?);
                }
                LinearReadEvent::Record { opcode, data } => {
                    if let Some(record) = self.taken(opcode, data)? {
                        return Ok(Some(record));
                    }
                }
            }
        }
        Ok(None)
    }

    /// Parses a record; `None` for types that are not needed.
    fn taken(&mut self, opcode: u8, data: &[u8]) -> Result<Option<Record<'static>>, String> {
        let is_of_use = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::STATISTICS);
        if !is_of_use {
            return Ok(None);
        }
        if !strings_fit(opcode, data) {
            return Err(
                "a text in it claims to be longer than the record that contains it".to_owned()
            );
        }
        let mut take = || {
            let record = parse_record(opcode, data)?.into_owned();
            match &record {
                Record::Schema { header, data } => {
                    self.known.add_schema_from_slice(header.clone(), data)?;
                }
                Record::Channel(channel) => self.known.add_channel(channel.clone())?,
                _ => {}
            }
            Ok(record)
        };
        take().map(Some).map_err(|error| in_words(&error))
    }
}

/// Whether the strings of a schema or a channel lie within its record.
fn strings_fit(opcode: u8, record: &[u8]) -> bool {
    fn sized<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
        let (size, rest) = bytes.split_first_chunk()?;
        let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*size) as usize)?;
        *bytes = rest;
        Some(text)
    }
    let numbers = match opcode {
        op::SCHEMA => 2,
        op::CHANNEL => 4,
        _ => return true,
    };
    let fit = || {
        let mut rest = record.get(numbers..)?;
        sized(&mut rest)?;
        sized(&mut rest)?;
        let mut last = sized(&mut rest)?; // the definition of a schema, the metadata of a channel
        while opcode == op::CHANNEL && !last.is_empty() {
            sized(&mut last)?;
        }
        Some(())
    };
    fit().is_some()
}

/// The topics in the summary at the end of a file, if there is one.
fn of_summary(file: &mut File) -> Result<Option<Vec<Topic>>, String> {
    const FOOTER: i64 = 20 + 8; // two positions and a checksum, then the magic bytes
    let at = |file: &mut File, to: SeekFrom| file.seek(to).map_err(|error| error.to_string());
    at(file, SeekFrom::End(-FOOTER))?;
    let mut start = [0; 8];
    file.read_exact(&mut start).map_err(|error| error.to_string())?;
    let start = u64::from_le_bytes(start);
    if start == 0 {
        return Ok(None);
    }
    at(file, SeekFrom::Start(start))?;
    let file = file.try_clone().map_err(|error| error.to_string())?;
    let options = LinearReaderOptions::default().with_skip_start_magic(true);
    let mut records = Records::new(file, options);
    let (mut channels, mut statistics) = (BTreeMap::new(), None::<Statistics>);
    while let Some(record) = records.next()? {
        match record {
            Record::Channel(channel) => {
                channels.extend(records.known.get(channel.id).map(|known| (channel.id, known)));
            }
            Record::Statistics(found) => statistics = Some(found),
            _ => {}
        }
    }
    let mut topics = Vec::new();
    for (id, channel) in &channels {
        let counts = statistics.as_ref().map(|statistics| &statistics.channel_message_counts);
        let messages = counts.map(|counts| counts.get(id).copied().unwrap_or(0));
        merge(&mut topics, vec![topic(channel, messages)]);
    }
    Ok(Some(topics))
}

fn topic(channel: &Arc<Channel<'_>>, messages: Option<u64>) -> Topic {
    let schema = channel.schema.as_ref();
    let text = schema.filter(|schema| schema.encoding == "ros2msg");
    let text = text.and_then(|schema| String::from_utf8(schema.data.to_vec()).ok());
    Topic {
        name: channel.topic.clone(),
        kind: schema.map_or_else(String::new, |schema| schema.name.clone()),
        messages,
        definition: text.filter(|text| !text.trim().is_empty()),
    }
}
