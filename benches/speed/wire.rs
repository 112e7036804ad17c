//! Cost of the network: the same iterations through the exchange and over gRPC on loopback.

use std::path::Path;
use std::process::{Child, Stdio};

use prost::Message as _;
use proto::wire::push_trajectory_request::Content;
use proto::{Digest, Incarnation, Lease, LeaseId, PolicyVersion, PushHeader, WeightsName, Work};
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::Effort;
use crate::end_to_end::COLD;
use crate::iteration::{Iteration, IterationLog, typical};
use crate::run_in_process::{ACTORS, FirstSlot, through_the_exchange};
use crate::settings::{self, CaseSettings, program};
use crate::table::CaseRow;
use crate::update::{CORES, TASKS};

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let settings = CaseSettings::of(&["halfcheetah-6x1"])?;
    let length = COLD + effort.iterations;
    let (mut exchange, mut grpc) = (Vec::new(), Vec::new());
    // Interleaved, so that other work on the machine affects all of them equally.
    for round in 0..effort.repeats.min(2) {
        let folder = tempfile::tempdir()?;
        let place = |name: &str| folder.path().join(format!("{name}-{round}"));
        let log = through_the_exchange(&settings, &place("exchange"), length)?;
        exchange.extend(log.after(COLD));
        grpc.extend(over_grpc(&settings, &place("grpc"), length)?.after(COLD));
    }
    let steps = (settings.learner.environments.count * settings.learner.environments.steps) as f64;
    let baseline = typical(&exchange);
    let row = |case: &str, iterations: &[Iteration]| {
        let Iteration { rollout, update, whole, processor } = typical(iterations);
        let figures = vec![
            ("rollout, s", rollout),
            ("update, s", update),
            ("iteration, s", whole),
            ("env steps/s", steps / whole),
            ("processor s", processor),
            ("iteration against the exchange, %", 100.0 * (whole / baseline.whole - 1.0)),
            ("processor s likewise, %", 100.0 * (processor / baseline.processor - 1.0)),
        ];
        CaseRow { case: case.to_owned(), figures }
    };
    Ok(vec![
        row("actors as threads, through the exchange", &exchange),
        row("actors as processes, over gRPC", &grpc),
    ])
}

/// Iterations of the real trainer, with actor processes.
fn over_grpc(
    settings: &CaseSettings,
    folder: &Path,
    iterations: usize,
) -> anyhow::Result<IterationLog> {
    let launch = settings.launch(folder, iterations)?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async {
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        let url = format!("http://{}", listener.local_addr()?);
        let start = |_| Ok(program(&["actor", "--learner", &url]).stderr(Stdio::null()).spawn()?);
        let actors: Vec<Child> = (0..ACTORS).map(start).collect::<anyhow::Result<_>>()?;
        let (log, (_stop, never)) = (IterationLog::default(), watch::channel(false));
        learner::run::run(launch, listener.into(), None, log.observer(), never).await?;
        for mut actor in actors {
            actor.wait()?;
        }
        Ok(log)
    })
}

/// Bytes of the messages, without HTTP/2 frames.
pub(crate) fn traffic(_effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    let mut rows = Vec::new();
    for task in TASKS {
        for core in CORES {
            let settings = CaseSettings::harl(task, &[settings::core(core)])?;
            rows.push(traffic_row(format!("{task} {core}"), &settings)?);
        }
        rows.push(traffic_row(format!("{task}, default preset"), &CaseSettings::of(&[task])?)?);
    }
    Ok(rows)
}

fn traffic_row(case: String, settings: &CaseSettings) -> anyhow::Result<CaseRow> {
    let mut slot = FirstSlot::of(settings)?;
    let chunks = slot.roll_out();
    let FirstSlot { run, work, policy, .. } = slot;
    let origin = work.origin();
    let lease = Lease {
        id: LeaseId(1),
        incarnation: Incarnation(1),
        weights: WeightsName { version: PolicyVersion(0), digest: Digest([0; 32]) },
        attempt: 0,
        work: Work::Rollout(work),
    };
    let bytes = |chunk: &proto::TrajectoryChunk| {
        let (message, digest) = chunk.to_wire(&run, &origin);
        PushHeader::of(&lease, digest).to_wire(Content::Chunk(message)).encoded_len()
    };
    let bytes: usize = chunks.iter().map(bytes).sum();
    let environments = &settings.learner.environments;
    let steps = (environments.per_slot * environments.steps) as f64;
    let figures = vec![
        ("slot, bytes", bytes as f64),
        ("bytes per env step", bytes as f64 / steps),
        ("weights, bytes", policy.to_bytes()?.len() as f64),
    ];
    Ok(CaseRow { case, figures })
}
