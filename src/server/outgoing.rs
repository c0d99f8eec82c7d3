//! The body of an answer while it is sent.

use std::convert::Infallible;

use axum::body::Body;
use bytes::Bytes;
use futures_util::stream;

/// One piece of an answer: small enough that most of a large one is still here while it is sent.
const PIECE: usize = 64 * 1024;

/// `bytes` as a body that keeps `guard` until the connection has taken all of it.
pub(crate) fn guarded<G: Send + 'static>(bytes: Vec<u8>, guard: G) -> Body {
    let unsent = (Bytes::from(bytes), guard);
    Body::from_stream(stream::unfold(unsent, |(mut bytes, guard)| async move {
        let piece = bytes.split_to(PIECE.min(bytes.len()));
        (!piece.is_empty()).then_some((Ok::<_, Infallible>(piece), (bytes, guard)))
    }))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use http_body_util::BodyExt;

    use super::*;

    #[tokio::test]
    async fn the_guard_lives_as_long_as_there_is_something_to_send() {
        let guard = Arc::new(());
        let bytes: Vec<u8> = (0..2 * PIECE + 1).map(|i| (i % 251) as u8).collect();
        let mut body = guarded(bytes.clone(), Arc::clone(&guard));
        let mut sent = Vec::new();
        while sent.len() < bytes.len() {
            assert_eq!(Arc::strong_count(&guard), 2);
            sent.extend(body.frame().await.unwrap().unwrap().into_data().unwrap());
        }
        assert_eq!(sent, bytes);
        assert!(body.frame().await.is_none());
        assert_eq!(Arc::strong_count(&guard), 1);
        drop(guarded(bytes, Arc::clone(&guard)));
        assert_eq!(Arc::strong_count(&guard), 1);
    }
}
