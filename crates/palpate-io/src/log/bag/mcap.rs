//! One file of MCAP: its topics, and the messages of some of them, chunk by chunk.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;
use std::sync::Arc;

use ::mcap::io::MessageReader;
use ::mcap::sans_io::{LinearReaderOptions, SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use ::mcap::{Channel, McapError, McapResult, Summary};

use super::topic::{Message, Messages, Topic, Which, merge};
use crate::{input, panics};

/// Bytes of the largest record that is read, usually 256 MiB: a picture of a hundred megapixels.
fn largest_record() -> usize {
    usize::try_from(input::largest() / 4).unwrap_or(usize::MAX)
}

/// The topics of a file: from its summary, or, if that is missing or broken off, from all of it.
/// An error is half a sentence.
pub(super) fn topics(path: &Path) -> Result<Vec<Topic>, String> {
    let mut file = open(path)?;
    let summary = panics::caught(|| summary(&mut file)).ok().and_then(Result::ok).flatten();
    if let Some(summary) = summary.filter(|summary| !summary.channels.is_empty()) {
        return Ok(of_summary(&summary));
    }
    let mut topics = Vec::new();
    for (messages, message) in read(open(path)?).enumerate() {
        match message {
            Ok(message) => merge(&mut topics, vec![topic(&message.channel, Some(1))]),
            // What lies before a break can be read; the break shows again when it is.
            Err(_) if messages > 0 => break,
            Err(why) => return Err(why),
        }
    }
    Ok(topics)
}

/// The messages of the wanted topics in a file. An error is half a sentence.
pub(super) fn messages(path: &Path, wanted: [Option<String>; 2]) -> Result<Messages, String> {
    let wanted_one = move |message: Result<::mcap::Message<'static>, String>| {
        let message = match message {
            Ok(message) => message,
            Err(why) => return Some(Err(why)),
        };
        let topic = Some(&message.channel.topic);
        let which = match &wanted {
            [samples, _] if samples.as_ref() == topic => Which::Sample,
            [_, markers] if markers.as_ref() == topic => Which::Marker,
            _ => return None,
        };
        let time_ns = i64::try_from(message.log_time).unwrap_or(i64::MAX);
        Some(Ok(Message { which, time_ns, data: message.data.into_owned() }))
    };
    Ok(Box::new(read(open(path)?).filter_map(wanted_one)))
}

fn open(path: &Path) -> Result<File, String> {
    input::open(path).map_err(|error| in_words(&error.into()))
}

/// What went wrong, as half a sentence.
fn in_words(error: &McapError) -> String {
    match error {
        McapError::UnexpectedEof | McapError::UnexpectedEoc => {
            "the file ends in the middle of it; was the recording, or a copy of it, cut short?"
                .to_owned()
        }
        McapError::BadMagic => "it does not begin or end as an MCAP file does".to_owned(),
        other => match std::error::Error::source(other) {
            Some(cause) => format!("{other}: {cause}"),
            None => other.to_string(),
        },
    }
}

/// All messages of a file; what the library panics with, where lengths contradict each other, ends
/// them as an error does. An error is half a sentence.
fn read(file: File) -> impl Iterator<Item = Result<::mcap::Message<'static>, String>> + Send {
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(largest_record());
    let mut reader = Some(MessageReader::new_with_options(BufReader::new(file), options));
    std::iter::from_fn(move || match panics::caught(|| reader.as_mut()?.next()) {
        Ok(message) => message.map(|message| message.map_err(|error| in_words(&error))),
        Err(why) => {
            reader = None;
            Some(Err(why))
        }
    })
}

/// The summary at the end of a file, if there is one.
fn summary(file: &mut File) -> McapResult<Option<Summary>> {
    let size = file.metadata()?.len();
    let limit = largest_record().min(usize::try_from(size).unwrap_or(usize::MAX));
    let options =
        SummaryReaderOptions::default().with_file_size(size).with_record_length_limit(limit);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(bytes) => {
                let read = file.read(reader.insert(bytes))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => {
                let at = file.seek(to)?;
                reader.notify_seeked(at);
            }
        }
    }
    Ok(reader.finish())
}

fn of_summary(summary: &Summary) -> Vec<Topic> {
    let mut channels: Vec<_> = summary.channels.values().collect();
    channels.sort_by_key(|channel| channel.id);
    let mut topics = Vec::new();
    for channel in channels {
        let counts = summary.stats.as_ref().map(|stats| &stats.channel_message_counts);
        let messages = counts.map(|counts| counts.get(&channel.id).copied().unwrap_or(0));
        merge(&mut topics, vec![topic(channel, messages)]);
    }
    topics
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
