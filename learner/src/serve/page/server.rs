//! The page's HTTP server: read-only, one request per connection, and a timeout of seconds. With TLS it answers only
//! clients with the role operator.

use std::net::SocketAddr;
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
use security::{Role, ServerTls, Standing};
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;

use super::{Hosts, Overlay, Page, RunView, answers, exposition};
use crate::serve::accepting::Accepting;

/// The page with its script and style.
const PAGE: &str = include_str!("page.html");

/// Most concurrent connections; further ones wait to be accepted.
const MOST_CONNECTIONS: usize = 32;
/// Time limit for the request and the response of a connection.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Most bytes of a request without its body; bodies are never read.
const MOST_HEADER_BYTES: usize = 16 << 10;

const EMBEDDING: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// What every request is checked against, and the policy that every response has.
#[derive(Debug)]
struct Rules {
    hosts: Hosts,
    policy: HeaderValue,
}

/// Serves `view` on `page` until dropped.
pub(crate) async fn serve(page: Page, view: Arc<RunView>) {
    accept(page.listener, page.tls, &checked(run_routes(view), page.hosts)).await;
}

/// Serves the curves of several runs on `page` until dropped. `look` reads their folders; it runs
/// on a blocking thread.
pub async fn serve_overlay(page: Page, look: impl Fn() -> Overlay + Send + Sync + 'static) {
    accept(page.listener, page.tls, &checked(overlay_routes(Arc::new(look)), page.hosts)).await;
}

fn run_routes(view: Arc<RunView>) -> Router {
    Router::new()
        .route("/", get(async || html(PAGE.to_owned())))
        .route("/api/run", get(async |State(view): Shared| json(view, answers::run).await))
        .route("/api/status", get(async |State(view): Shared| json(view, answers::status).await))
        .route("/api/curves", get(async |State(view): Shared| json(view, answers::curves).await))
        .route("/api/film", get(async |State(view): Shared| json(view, answers::film).await))
        .route("/metrics", get(async |State(view): Shared| metrics(view).await))
        .with_state(view)
}

fn overlay_routes(look: Arc<dyn Fn() -> Overlay + Send + Sync>) -> Router {
    let again = Arc::clone(&look);
    let all = look;
    let page = PAGE.replacen("<html ", "<html data-view=\"runs\" ", 1);
    Router::new()
        .route("/", get(async move || html(page)))
        .route("/api/runs", get(async move || overlay(again, answers::runs).await))
        .route("/api/curves", get(async move || overlay(all, answers::curves_of_runs).await))
}

fn html(page: String) -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/html; charset=utf-8")], page)
}

fn checked(routes: Router, hosts: Hosts) -> Router {
    let rules = Arc::new(Rules { hosts, policy: content_policy(PAGE) });
    routes.layer(middleware::from_fn_with_state(rules, check))
}

type Shared = State<Arc<RunView>>;

async fn accept(listener: TcpListener, tls: Option<ServerTls>, routes: &Router) {
    let room = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    let mut accepting = Accepting::new(listener, "page");
    let mut open = JoinSet::new();
    while let Ok(permit) = Arc::clone(&room).acquire_owned().await {
        let (stream, peer) = accepting.next().await;
        let (tls, routes) = (tls.clone(), routes.clone());
        open.spawn(async move {
            let answered = async {
                match tls {
                    None => answer(stream, routes).await,
                    Some(tls) => answer_over_tls(stream, peer, tls, routes).await,
                }
            };
            // A client that is too slow gets no answer.
            let _result = tokio::time::timeout(TIMEOUT, answered).await;
            drop(permit);
        });
        while open.try_join_next().is_some() {}
    }
}

/// Serves one request.
async fn answer(stream: impl AsyncRead + AsyncWrite + Unpin, routes: Router) {
    let mut server = http1::Builder::new();
    server.keep_alive(false).max_buf_size(MOST_HEADER_BYTES);
    let served = server.serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes));
    // Errors concern only this client, which disconnected.
    let _result = served.await;
}

/// Performs the handshake, then serves one request of a client that is an operator; others get the reason.
async fn answer_over_tls(stream: TcpStream, peer: SocketAddr, tls: ServerTls, routes: Router) {
    match TlsAcceptor::from(tls.config()).accept(stream).await {
        Ok(stream) => {
            let standing = Standing::of_chain(stream.get_ref().1.peer_certificates());
            match standing.demand(Role::Operator) {
                Ok(()) => answer(stream, routes).await,
                Err(denied) => {
                    let refusal = (StatusCode::FORBIDDEN, format!("{denied}\n"));
                    answer(stream, Router::new().fallback(refusal)).await;
                }
            }
        }
        Err(error) => tracing::warn!(%peer, "page: connection rejected: {error}"),
    }
}

/// Rejects other hosts and methods, and sets the security headers.
async fn check(State(rules): State<Arc<Rules>>, request: Request, next: Next) -> Response {
    let mut hosts = request.headers().get_all(HOST).into_iter();
    let host = hosts.next().and_then(|host| host.to_str().ok()).unwrap_or_default();
    let mut response = if hosts.next().is_some() || !rules.hosts.allow(host) {
        let why = "this host name is not allowed; add it with --page-host\n";
        (StatusCode::FORBIDDEN, why).into_response()
    } else if ![Method::GET, Method::HEAD].contains(request.method()) {
        (StatusCode::METHOD_NOT_ALLOWED, [(ALLOW, "GET, HEAD")]).into_response()
    } else {
        next.run(request).await
    };
    let headers = response.headers_mut();
    headers.insert(CONTENT_SECURITY_POLICY, rules.policy.clone());
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

async fn json(view: Arc<RunView>, answer: fn(&RunView) -> Value) -> Response<Body> {
    written("application/json", move || answer(&view).to_string()).await
}

async fn overlay(
    look: Arc<dyn Fn() -> Overlay + Send + Sync>,
    answer: fn(&Overlay) -> Value,
) -> Response<Body> {
    written("application/json", move || answer(&look()).to_string()).await
}

async fn metrics(view: Arc<RunView>) -> Response<Body> {
    written(exposition::CONTENT_TYPE, move || exposition::text(&view)).await
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
