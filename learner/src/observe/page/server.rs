//! The page's HTTP server: read-only, one request per connection, and a timeout of seconds.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{
    ALLOW, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use super::{Hosts, Page, RunView, answers, exposition};

/// The page with its script and style.
const PAGE: &str = include_str!("page.html");

/// Most concurrent connections; further ones wait to be accepted.
const MOST_CONNECTIONS: usize = 32;
/// Time limit for the request and the response of a connection.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Most bytes of a request without its body; bodies are never read.
const MOST_HEADER_BYTES: usize = 16 << 10;
/// Pause after a failed accept, for example because the process is out of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

const EMBEDDING: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// State shared by all connections.
#[derive(Debug)]
struct Site {
    view: Arc<RunView>,
    hosts: Hosts,
    policy: HeaderValue,
}

/// Serves `view` on `page` until dropped.
pub(crate) async fn serve(page: Page, view: Arc<RunView>) {
    let site = Site { view, hosts: page.hosts, policy: content_policy(PAGE) };
    accept(&page.listener, &routes(Arc::new(site))).await;
}

fn routes(site: Arc<Site>) -> Router {
    Router::new()
        .route("/", get(async || ([(CONTENT_TYPE, "text/html; charset=utf-8")], PAGE)))
        .route("/api/run", get(async |State(site): Shared| json(site, answers::run).await))
        .route("/api/status", get(async |State(site): Shared| json(site, answers::status).await))
        .route("/api/curves", get(async |State(site): Shared| json(site, answers::curves).await))
        .route("/api/film", get(async |State(site): Shared| json(site, answers::film).await))
        .route("/metrics", get(async |State(site): Shared| metrics(site).await))
        .layer(middleware::from_fn_with_state(Arc::clone(&site), check))
        .with_state(site)
}

type Shared = State<Arc<Site>>;

async fn accept(listener: &TcpListener, routes: &Router) {
    let room = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    let mut open = JoinSet::new();
    while let Ok(permit) = Arc::clone(&room).acquire_owned().await {
        match listener.accept().await {
            Ok((stream, _)) => {
                let answered = answer(stream, routes.clone());
                open.spawn(async move {
                    answered.await;
                    drop(permit);
                });
            }
            Err(error) => {
                tracing::warn!("the page cannot accept a connection: {error}");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
        while open.try_join_next().is_some() {}
    }
}

/// Serves one request, or none if it does not arrive in time.
async fn answer(stream: TcpStream, routes: Router) {
    let mut server = http1::Builder::new();
    server.keep_alive(false).max_buf_size(MOST_HEADER_BYTES);
    let served = server.serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes));
    // Errors concern only this client, which disconnected or was too slow.
    let _result = tokio::time::timeout(TIMEOUT, served).await;
}

/// Rejects other hosts and methods, and sets the security headers.
async fn check(State(site): Shared, request: Request, next: Next) -> Response {
    let host = request.headers().get(HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let mut response = if !site.hosts.allow(host) {
        let why = "this host name is not allowed; add it with --page-host\n";
        (StatusCode::FORBIDDEN, why).into_response()
    } else if ![Method::GET, Method::HEAD].contains(request.method()) {
        (StatusCode::METHOD_NOT_ALLOWED, [(ALLOW, "GET, HEAD")]).into_response()
    } else {
        next.run(request).await
    };
    let headers = response.headers_mut();
    headers.insert(CONTENT_SECURITY_POLICY, site.policy.clone());
    for (name, value) in [
        (CACHE_CONTROL, "no-store"),
        (EMBEDDING, "same-origin"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn json(site: Arc<Site>, answer: fn(&RunView) -> Value) -> Response<Body> {
    written("application/json", move || answer(&site.view).to_string()).await
}

async fn metrics(site: Arc<Site>) -> Response<Body> {
    written(exposition::CONTENT_TYPE, move || exposition::text(&site.view)).await
}

/// Responds with the text that `write` produces. It runs on a blocking thread, because actors need the network threads.
async fn written(
    content_type: &'static str,
    write: impl FnOnce() -> String + Send + 'static,
) -> Response<Body> {
    match tokio::task::spawn_blocking(write).await {
        Ok(text) => ([(CONTENT_TYPE, content_type)], text).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// Content security policy: the page's own inline script and style, and requests to its own origin only.
fn content_policy(page: &str) -> HeaderValue {
    let hash = |tag: &str| {
        let inside = page.split_once(&format!("<{tag}>")).map_or("", |(_, after)| after);
        let inside = inside.split_once(&format!("</{tag}>")).map_or("", |(text, _)| text);
        STANDARD.encode(Sha256::digest(inside))
    };
    let policy = format!(
        "default-src 'none'; script-src 'sha256-{}'; style-src 'sha256-{}'; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        hash("script"),
        hash("style")
    );
    HeaderValue::from_str(&policy).expect("the policy is ASCII")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_policy_contains_the_hashes_of_script_and_style() {
        let page = "<style>b{}</style><script>a()</script>";
        let policy = content_policy(page);
        // base64.b64encode(hashlib.sha256(b"a()").digest()), and of b"b{}".
        let script = "script-src 'sha256-qVpDBgj7bpq5hMAcGp3AOc79J3Y1Z4HvySTwKrWDoy4='";
        let style = "style-src 'sha256-7yqHVAesot11p6HczDsgKRipvI5UPgs97z80zNXlans='";
        let policy = policy.to_str().unwrap();
        assert!(policy.contains(script) && policy.contains(style), "{policy}");
    }

    #[test]
    fn the_page_makes_no_external_requests() {
        for outside in ["http:", "https:", "//cdn", "src=", "@import", "url("] {
            assert!(!PAGE.contains(outside), "{outside}");
        }
        assert_eq!((PAGE.matches("<script>").count(), PAGE.matches("<style>").count()), (1, 1));
    }
}
