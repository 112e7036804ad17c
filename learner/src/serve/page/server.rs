//! The page's HTTP server: read-only, one request per connection, five seconds for a request and a minute for its response.
//! With TLS it answers only clients with the role operator.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, Request, State};
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
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use security::{Permissions, Role, ServerTls};
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;

use super::{EpisodeName, Hosts, Page, RunView, Runs, ShownRun, answers, exposition};
use crate::serve::accepting::Accepting;

/// The page with its script and style.
const PAGE: &str = concat!(
    include_str!("html/head.html"),
    "<style>",
    include_str!("html/page.css"),
    "</style>",
    include_str!("html/body.html"),
    "<script>",
    include_str!("html/numbers.js"),
    include_str!("html/charts.js"),
    include_str!("html/robot.js"),
    include_str!("html/page.js"),
    "</script>",
);

/// The document whose tables explain the metrics.
const EXPLANATIONS: &str = include_str!("../../../../docs/PAPER.md");

/// Most concurrent connections; further ones wait to be accepted.
const MOST_CONNECTIONS: usize = 32;
/// Time limit for the handshake and the request of a connection.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Time limit for a connection with its response.
const LONGEST: Duration = Duration::from_secs(60);
/// Most bytes of a request without its body; bodies are never read.
const MOST_HEADER_BYTES: usize = 16 << 10;

const EMBEDDING: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// What every request is checked against, and the policy that every response has.
#[derive(Debug)]
struct Rules {
    hosts: Hosts,
    policy: HeaderValue,
}

/// Serves `runs` on `page` until dropped.
pub async fn serve(page: Page, runs: Arc<dyn Runs>) {
    accept(page.listener, page.tls, &checked(routes(runs), page.hosts)).await;
}

/// Serves the run of this process, also for Prometheus, until dropped.
pub(crate) async fn serve_live(page: Page, view: Arc<RunView>) {
    let scraped = Arc::clone(&view);
    let text = move || {
        ([(CONTENT_TYPE, exposition::CONTENT_TYPE)], exposition::text(&scraped)).into_response()
    };
    let metrics = get(async move || answered(text).await);
    let routes = routes(view).route("/metrics", metrics);
    accept(page.listener, page.tls, &checked(routes, page.hosts)).await;
}

fn routes(runs: Arc<dyn Runs>) -> Router {
    type Named = Path<(usize, u64, u32)>;
    Router::new()
        .route("/", get(async || ([(CONTENT_TYPE, "text/html; charset=utf-8")], PAGE)))
        .route("/metrics.md", get(async || ([(CONTENT_TYPE, "text/markdown")], EXPLANATIONS)))
        .route(
            "/api/runs",
            get(async |State(runs): Shared| {
                answered(move || json(&answers::runs(&runs.look()))).await
            }),
        )
        .route(
            "/api/runs/{run}",
            get(async |State(runs): Shared, Path(run): Path<usize>| {
                of_run(runs, run, move |runs, _| answers::facts(runs.facts(run))).await
            }),
        )
        .route(
            "/api/curves/{run}",
            get(async |State(runs): Shared, Path(run): Path<usize>| {
                of_run(runs, run, |_, shown| answers::curves(shown)).await
            }),
        )
        .route(
            "/api/film/{run}/{iteration}/{episode}",
            get(async |State(runs): Shared, Path((run, iteration, index)): Named| {
                let name = EpisodeName { iteration, index };
                of_run(runs, run, move |runs, _| answers::film(runs.film(run, name))).await
            }),
        )
        .with_state(runs)
}

fn checked(routes: Router, hosts: Hosts) -> Router {
    let rules = Arc::new(Rules { hosts, policy: content_policy(PAGE) });
    routes.layer(middleware::from_fn_with_state(rules, check))
}

type Shared = State<Arc<dyn Runs>>;

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
            let _result = tokio::time::timeout(LONGEST, answered).await;
            drop(permit);
        });
        while open.try_join_next().is_some() {}
    }
}

/// Serves one request.
async fn answer(stream: impl AsyncRead + AsyncWrite + Unpin, routes: Router) {
    let mut server = http1::Builder::new();
    server.keep_alive(false).max_buf_size(MOST_HEADER_BYTES);
    server.timer(TokioTimer::new()).header_read_timeout(TIMEOUT);
    let served = server.serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes));
    // Errors concern only this client, which disconnected.
    let _result = served.await;
}

/// Performs the handshake, then serves one request of a client that is an operator; others get the reason.
async fn answer_over_tls(stream: TcpStream, peer: SocketAddr, tls: ServerTls, routes: Router) {
    let handshake = TlsAcceptor::from(tls.config()).accept(stream);
    let Ok(handshake) = tokio::time::timeout(TIMEOUT, handshake).await else { return };
    match handshake {
        Ok(stream) => {
            let permissions = Permissions::of_chain(stream.get_ref().1.peer_certificates());
            match permissions.demand(Role::Operator) {
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

/// Responds with what `answer` makes of the run with this index, or with the status code 404.
async fn of_run(
    runs: Arc<dyn Runs>,
    run: usize,
    answer: impl FnOnce(&dyn Runs, &ShownRun) -> Value + Send + 'static,
) -> Response {
    answered(move || {
        let all = runs.look();
        match all.get(run) {
            Some(shown) => json(&answer(&*runs, shown)),
            None => {
                let why =
                    format!("there is no run {run}: the {} runs are counted from 0\n", all.len());
                (StatusCode::NOT_FOUND, why).into_response()
            }
        }
    })
    .await
}

fn json(answer: &Value) -> Response {
    ([(CONTENT_TYPE, "application/json")], answer.to_string()).into_response()
}

/// Responds with `answer`, which runs on a blocking thread, because actors need the network threads.
async fn answered(answer: impl FnOnce() -> Response + Send + 'static) -> Response {
    let response = tokio::task::spawn_blocking(answer).await;
    response.unwrap_or_else(|_| StatusCode::INTERNAL_SERVER_ERROR.into_response())
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
