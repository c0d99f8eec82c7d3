//! The viewer for a browser of ours, which draws a dance and sends its pictures back.

use std::{io, sync::Arc};

use axum::{
    Router,
    body::Bytes,
    extract::{DefaultBodyLimit, Path, State},
    http::{StatusCode, header},
    response::IntoResponse,
    routing::{get, post},
};
use tokio::{net::TcpListener, sync::mpsc};

use super::routes::viewer;

/// Largest picture in bytes.
const LARGEST_PICTURE: usize = 64 << 20;

/// A dance to be drawn, and where its pictures go.
#[derive(Debug)]
pub struct Film {
    /// The dance as JSON with rotations.
    pub dance: Bytes,
    /// A secret of the browser's address: nobody else on this host is answered.
    pub token: String,
    /// Receives each picture, as PNG, or why there are none. The browser waits while it is full.
    pub pictures: mpsc::Sender<Result<Bytes, String>>,
}

/// Serves the page and the dance, and receives the pictures, for as long as it is polled.
///
/// # Errors
/// Those of the listener.
pub async fn serve_film(listener: TcpListener, film: Film) -> io::Result<()> {
    axum::serve(listener, routes(film)).await
}

fn routes(film: Film) -> Router {
    Router::new()
        .route("/film/{token}/dance", get(dance))
        .route("/film/{token}/picture", post(picture))
        .route("/film/{token}/failure", post(failure))
        .layer(DefaultBodyLimit::max(LARGEST_PICTURE))
        .with_state(Arc::new(film))
        .merge(viewer::routes(false))
}

async fn dance(State(film): State<Arc<Film>>, Path(token): Path<String>) -> impl IntoResponse {
    match token == film.token {
        true => Ok(([(header::CONTENT_TYPE, "application/json")], film.dance.clone())),
        false => Err(StatusCode::NOT_FOUND),
    }
}

async fn picture(
    State(film): State<Arc<Film>>,
    Path(token): Path<String>,
    picture: Bytes,
) -> StatusCode {
    film.receive(&token, Ok(picture)).await
}

async fn failure(
    State(film): State<Arc<Film>>,
    Path(token): Path<String>,
    reason: String,
) -> StatusCode {
    film.receive(&token, Err(reason)).await
}

impl Film {
    async fn receive(&self, token: &str, picture: Result<Bytes, String>) -> StatusCode {
        if token != self.token {
            return StatusCode::NOT_FOUND;
        }
        match self.pictures.send(picture).await {
            Ok(()) => StatusCode::NO_CONTENT,
            Err(_) => StatusCode::GONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use axum::{
        body::Body,
        http::{Method, Request},
    };
    use tower::ServiceExt;

    use super::*;

    #[tokio::test]
    async fn pictures_arrive_from_the_browser_that_was_told_the_secret() {
        let (pictures, mut received) = mpsc::channel(2);
        let dance = Bytes::from_static(b"{}");
        let routes = routes(Film { dance, token: "secret".into(), pictures });
        let ask = async |method: Method, path: &str, body: &'static str| {
            let request = Request::builder().method(method).uri(path).body(Body::from(body));
            routes.clone().oneshot(request.unwrap()).await.unwrap().status()
        };
        assert_eq!(ask(Method::GET, "/", "").await, StatusCode::OK);
        assert_eq!(ask(Method::GET, "/film/secret/dance", "").await, StatusCode::OK);
        assert_eq!(ask(Method::GET, "/film/guess/dance", "").await, StatusCode::NOT_FOUND);
        let guess = ask(Method::POST, "/film/guess/picture", "png").await;
        assert_eq!(guess, StatusCode::NOT_FOUND);
        let sent = ask(Method::POST, "/film/secret/picture", "png").await;
        assert_eq!(sent, StatusCode::NO_CONTENT);
        ask(Method::POST, "/film/secret/failure", "no WebGL").await;
        assert_eq!(received.recv().await.unwrap().unwrap(), "png");
        assert_eq!(received.recv().await.unwrap().unwrap_err(), "no WebGL");
    }
}
