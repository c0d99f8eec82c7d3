//! Dances as they are written: once for all readers who ask for the same.

use std::{
    future::Future,
    sync::{Arc, Mutex, PoisonError, Weak},
};

use bytes::Bytes;

use crate::{
    formats::{Character, FormatError, GeneratedMotion, OutputFormat, WriteOptions},
    server::{
        blocking,
        error::ServerError,
        layers::client::Client,
        metrics::SharedMetrics,
        options::RequestOptions,
        resources::{Reservation, Resources, Stay},
        response::{encoding::Encoding, negotiate::Shape},
        tracker::Work,
    },
};

/// A dance that was written, and the memory that is reserved for it.
#[derive(Debug)]
pub(crate) struct Written {
    bytes: Vec<u8>,
    encoding: Encoding,
    _room: Reservation,
}

impl Written {
    /// Writes a dance within the answer memory of `client`: room is taken first. `work` is held
    /// until that has ended, whether or not somebody waits for it.
    ///
    /// # Errors
    /// [`ServerError`] where there is no room; what writing fails with.
    pub(crate) async fn new(
        held: (&Resources, &SharedMetrics),
        client: Client,
        work: Option<Arc<Work>>,
        dance: Arc<GeneratedMotion>,
        options: &RequestOptions,
        Shape { format, encoding, .. }: Shape,
    ) -> Result<Arc<Self>, ServerError> {
        let most = format.most_bytes(dance.size(), &options.writing());
        let options = options.clone();
        let write = move || options.write(&dance, format);
        Self::of(held, client, work, (most, encoding), write).await
    }

    /// [`Self::new`] on the bones of a character, whose feet are held where they stand if they are
    /// to be planted. The caller chooses how many bones there are, so that what all answers have
    /// may be too little for one.
    ///
    /// # Errors
    /// As [`Self::new`]; [`ServerError::RigTooLong`].
    pub(crate) async fn on_rig(
        held: (&Resources, &SharedMetrics),
        client: Client,
        work: Option<Arc<Work>>,
        dance: Arc<GeneratedMotion>,
        (character, planted, encoding): (Arc<Character>, bool, Encoding),
    ) -> Result<Arc<Self>, ServerError> {
        let most = character.most_bytes(dance.animation.root.len());
        held.0.check_fits(most)?;
        let write = move || character.dance(&dance, planted);
        Self::of(held, client, work, (most, encoding), write).await
    }

    async fn of(
        (resources, metrics): (&Resources, &SharedMetrics),
        client: Client,
        work: Option<Arc<Work>>,
        (most, encoding): (usize, Encoding),
        write: impl FnOnce() -> Result<Vec<u8>, FormatError> + Send + 'static,
    ) -> Result<Arc<Self>, ServerError> {
        let most = encoding.most_bytes(most);
        let mut room = resources.reserve_response(client, most).await?;
        let write = move || {
            let coded = encoding.encode(write()?);
            let (mut bytes, encoding) =
                coded.map_err(|error| ServerError::Internal(error.to_string()))?;
            bytes.shrink_to_fit();
            room.shrink_to(bytes.len() as u64);
            Ok(Arc::new(Self { bytes, encoding, _room: room }))
        };
        blocking::write(metrics, work, write).await
    }

    /// How its bytes are coded.
    pub(crate) fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// All of it, for one more reader.
    pub(crate) fn bytes(self: &Arc<Self>) -> Bytes {
        struct Shared(Arc<Written>);
        impl AsRef<[u8]> for Shared {
            fn as_ref(&self) -> &[u8] {
                &self.0.bytes
            }
        }
        Bytes::from_owner(Shared(Arc::clone(self)))
    }
}

/// How a dance is written: who asks for the same gets the same.
type Kind = (OutputFormat, Encoding, WriteOptions);
type Slot = Arc<tokio::sync::Mutex<Weak<Written>>>;

/// What is being written of one dance, or was written and still has readers.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    // Held only to find or to put one; there are as many as there are kinds.
    slots: Mutex<Vec<(Kind, Slot)>>,
}

impl Answers {
    fn slot(&self, kind: Kind) -> Slot {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, slot)) = slots.iter().find(|(known, _)| *known == kind) {
            return Arc::clone(slot);
        }
        let slot = Slot::default();
        slots.push((kind, Arc::clone(&slot)));
        slot
    }

    /// Whether something that was written has readers still.
    pub(crate) fn is_read(&self) -> bool {
        let slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots
            .iter()
            .any(|(_, slot)| slot.try_lock().is_ok_and(|written| written.strong_count() > 0))
    }

    /// The dance that `load` gives as asked for. It is loaded and written in a task of its own,
    /// which has a place to write in and the memory for it: a reader who leaves does not free what
    /// the writing still needs.
    ///
    /// # Errors
    /// As [`Written::new`]; [`ServerError::QueueFull`] where too much is to be written; what `load`
    /// fails with.
    pub(crate) async fn get(
        self: Arc<Self>,
        (resources, metrics): (&Arc<Resources>, &SharedMetrics),
        client: Client,
        load: impl Future<Output = Result<GeneratedMotion, ServerError>> + Send + 'static,
        options: &RequestOptions,
        shape: Shape,
    ) -> Result<Arc<Written>, ServerError> {
        let slot = self.slot((shape.format, shape.encoding, options.writing()));
        let mut slot = slot.lock_owned().await;
        if let Some(written) = slot.upgrade() {
            return Ok(written);
        }
        let (resources, metrics) = (Arc::clone(resources), Arc::clone(metrics));
        let options = options.clone();
        let written = tokio::spawn(async move {
            // All readers find this one, as long as it writes.
            let _shared = self;
            let _place = resources.writers.admit(client, Stay::Short).await?;
            let dance = Arc::new(load.await?);
            let held = (&*resources, &metrics);
            let written = Written::new(held, client, None, dance, &options, shape).await?;
            *slot = Arc::downgrade(&written);
            Ok(written)
        });
        let failed =
            |failed: tokio::task::JoinError| Err(ServerError::Internal(failed.to_string()));
        written.await.unwrap_or_else(failed)
    }
}
