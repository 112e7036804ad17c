//! Spans of real runs, as a collector gets them: `cargo test --features otel --test telemetry`.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "system/runs.rs"]
mod runs;

use std::net::TcpListener;
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{
    TraceService, TraceServiceServer,
};
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::tonic::common::v1::{KeyValue, any_value::Value};
use opentelemetry_proto::tonic::trace::v1::Span;
use runs::{Runs, TINY, inspect, train};
use tokio::runtime::Runtime;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status};

/// Two iterations of two slots by one actor, and a checkpoint after the second.
const TWO: [&str; 2] = ["run.iterations=2", "run.actors=1"];

/// How long an answer of the collector is waited for by whoever waits for it.
const PATIENCE: Duration = Duration::from_secs(60);

/// Spans with the service that sent them.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<(String, Span)>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        for sent in request.into_inner().resource_spans {
            let service = text(&sent.resource.unwrap().attributes, "service.name");
            let spans = sent.scope_spans.into_iter().flat_map(|scope| scope.spans);
            self.0.lock().unwrap().extend(spans.map(|span| (service.clone(), span)));
        }
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

impl Collector {
    /// Serves for as long as the runtime lives; its address.
    fn serve(&self, runtime: &Runtime) -> String {
        let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
        let address = listener.local_addr().unwrap();
        let service = TraceServiceServer::new(self.clone());
        let server = tonic::transport::Server::builder().add_service(service);
        runtime.spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
        format!("http://{address}")
    }

    fn spans(&self) -> Vec<(String, Span)> {
        self.0.lock().unwrap().clone()
    }
}

fn value(attributes: &[KeyValue], key: &str) -> Value {
    let found = attributes.iter().find(|attribute| attribute.key == key);
    found.unwrap_or_else(|| panic!("no {key}")).value.clone().unwrap().value.unwrap()
}

fn text(attributes: &[KeyValue], key: &str) -> String {
    match value(attributes, key) {
        Value::StringValue(text) => text,
        other => panic!("{key} is no text: {other:?}"),
    }
}

/// Names of the spans within `outer`, sorted, with the services that sent them.
fn within<'a>(spans: &'a [(String, Span)], outer: &Span) -> Vec<(&'a str, &'a str)> {
    let inner = spans.iter().filter(|(_, span)| span.parent_span_id == outer.span_id);
    let inner = inner.filter(|(_, span)| span.trace_id == outer.trace_id);
    let mut names: Vec<_> = inner.map(|(service, span)| (&*span.name, &**service)).collect();
    names.sort_unstable();
    names
}

fn named<'a>(spans: &'a [(String, Span)], name: &'a str) -> impl Iterator<Item = &'a Span> {
    spans.iter().map(|(_, span)| span).filter(move |span| span.name == name)
}

/// Trains and sends spans to `endpoint`; what was said on stderr.
fn train_and_tell(folder: &Path, endpoint: &str) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_s2mia"))
        .arg("train")
        .args(TINY)
        .arg(format!("run.dir={}", folder.display()))
        .args(TWO)
        .env("OTEL_EXPORTER_OTLP_ENDPOINT", endpoint)
        .env("OTEL_BSP_SCHEDULE_DELAY", "50")
        .env("OTEL_EXPORTER_OTLP_TIMEOUT", PATIENCE.as_millis().to_string())
        .output()
        .unwrap();
    let told = String::from_utf8(run.stderr).unwrap();
    assert!(run.status.success(), "{told}");
    told
}

#[test]
fn an_iteration_is_one_trace_through_the_learner_and_its_actors() {
    const LEARNER: &str = "s2mia-learner";
    const ACTOR: &str = "s2mia-actor";
    let (runtime, collector, runs) = (Runtime::new().unwrap(), Collector::default(), Runs::new());
    train_and_tell(&runs.folder("told"), &collector.serve(&runtime));
    let spans = collector.spans();
    let mut iterations: Vec<&Span> = named(&spans, "iteration").collect();
    iterations.sort_by_key(|span| span.start_time_unix_nano);
    let learnt = [("collect", LEARNER), ("refit", LEARNER), ("update", LEARNER)];
    let leases = [("lease", ACTOR), ("lease", ACTOR)];
    assert_eq!(iterations.len(), 2);
    for (index, iteration) in iterations.iter().enumerate() {
        let (iterations, env_steps) = (index as i64, 80 * (index as i64 + 1));
        assert_eq!(value(&iteration.attributes, "iteration"), Value::IntValue(iterations));
        assert_eq!(value(&iteration.attributes, "env_steps"), Value::IntValue(env_steps));
        let saved = (index == 1).then_some(("save", LEARNER));
        let mut expected: Vec<_> = learnt.into_iter().chain(leases).chain(saved).collect();
        expected.sort_unstable();
        assert_eq!(within(&spans, iteration), expected);
    }
    for lease in named(&spans, "lease") {
        assert_eq!(
            within(&spans, lease),
            [("push", ACTOR), ("rollout", ACTOR), ("weights", ACTOR)]
        );
    }
}

#[test]
fn spans_change_not_one_bit_of_a_run() {
    let (runtime, collector, runs) = (Runtime::new().unwrap(), Collector::default(), Runs::new());
    let (told, untold) = (runs.folder("told"), runs.folder("untold"));
    train_and_tell(&told, &collector.serve(&runtime));
    train(&untold, &TWO);
    assert_eq!(inspect(&told), inspect(&untold));
}

#[test]
fn a_collector_that_never_answers_holds_nobody_up() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", silent.local_addr().unwrap());
    let begun = Instant::now();
    train_and_tell(&Runs::new().folder("untold"), &endpoint);
    assert!(begun.elapsed() < PATIENCE / 2, "{:?}", begun.elapsed());
}

#[test]
fn a_run_goes_on_without_its_collector_and_each_process_says_so_once() {
    // Nobody listens on the first port.
    for endpoint in ["http://127.0.0.1:1", "http://no address"] {
        let runs = Runs::new();
        let folder = runs.folder("untold");
        let learner = train_and_tell(&folder, endpoint);
        let actor = std::fs::read_to_string(folder.join("logs/actor_0.log")).unwrap();
        for told in [learner, actor] {
            assert_eq!(told.matches("goes on without them").count(), 1, "{told}");
        }
    }
}
