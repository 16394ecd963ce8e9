//! Reads `.rrd` files back with Rerun's decoder, for tests.

use std::collections::BTreeMap;

use re_log_encoding::Decoder;
use re_sdk::StoreKind;
use re_sdk::log::{Chunk, LogMsg};
use re_sdk_types::archetypes::Scalars;
use re_sdk_types::components::Scalar;

use crate::recording::ViewError;

/// The chunks of a recording in their order, without its layout.
///
/// # Errors
///
/// If the bytes are not a complete recording.
pub fn chunks(bytes: &[u8]) -> Result<Vec<Chunk>, ViewError> {
    read(bytes, StoreKind::Recording)
}

/// Number of rows of each entity.
///
/// # Errors
///
/// As [`chunks`].
pub fn rows(bytes: &[u8]) -> Result<BTreeMap<String, usize>, ViewError> {
    let mut rows = BTreeMap::new();
    for chunk in chunks(bytes)? {
        let entity = chunk.entity_path().to_string();
        *rows.entry(entity).or_default() += chunk.num_rows();
    }
    Ok(rows)
}

/// The scalars that were logged for an entity.
///
/// # Errors
///
/// As [`chunks`].
pub fn scalars(bytes: &[u8], entity: &str) -> Result<Vec<f64>, ViewError> {
    let mut numbers = Vec::new();
    for chunk in chunks(bytes)?.iter().filter(|c| c.entity_path().to_string() == entity) {
        let component = Scalars::descriptor_scalars().component;
        let said = chunk.iter_component::<Scalar>(component);
        numbers
            .extend(said.flat_map(|row| row.iter().map(|number| number.0.0).collect::<Vec<_>>()));
    }
    Ok(numbers)
}

/// The entities of the layout.
///
/// # Errors
///
/// As [`chunks`].
pub fn layout(bytes: &[u8]) -> Result<Vec<String>, ViewError> {
    let of = |chunks: Vec<Chunk>| chunks.iter().map(|c| c.entity_path().to_string()).collect();
    read(bytes, StoreKind::Blueprint).map(of)
}

fn read(bytes: &[u8], kind: StoreKind) -> Result<Vec<Chunk>, ViewError> {
    let messages = Decoder::<LogMsg>::decode_eager(bytes).map_err(refused)?;
    let mut chunks = Vec::new();
    for message in messages {
        match message.map_err(refused)? {
            LogMsg::ArrowMsg(store, message) if store.kind() == kind => {
                chunks.push(Chunk::from_arrow_msg(&message).map_err(refused)?);
            }
            _ => {}
        }
    }
    Ok(chunks)
}

fn refused(error: impl std::error::Error + Send + Sync + 'static) -> ViewError {
    ViewError::Record(Box::new(error))
}
