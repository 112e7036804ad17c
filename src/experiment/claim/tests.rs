//! Two hosts and one claim.

use super::*;

const SHORT: Times = Times {
    beat: Duration::from_millis(5),
    stale: Duration::from_millis(60),
    settle: Duration::from_millis(10),
    retry: Duration::from_millis(1),
    poll: Duration::from_millis(1),
};

fn on(host: &str) -> Claimant {
    Claimant { host: host.to_owned(), boot: "1".to_owned(), times: SHORT }
}

fn place() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.claim");
    (folder, path)
}

/// What a process of `host` leaves when it is killed.
fn abandoned(path: &Path, host: &str) -> Holder {
    let holder = Holder { host: host.into(), boot: "1".into(), pid: 7, id: "old".into(), beat: 3 };
    let file = File::create(path).unwrap();
    write(&file, &holder).unwrap();
    holder
}

async fn claimed(claimant: &Claimant, path: &Path) -> Claim {
    match claimant.claim(path, None).await.unwrap() {
        Attempt::Claimed(claim) => claim,
        other => panic!("{other:?}"),
    }
}

/// Tries until the claim is clear.
async fn judged(claimant: &Claimant, path: &Path) -> Attempt {
    let mut seen = None;
    loop {
        match claimant.claim(path, seen).await.unwrap() {
            Attempt::Unclear(sighting) => seen = Some(sighting),
            clear => return clear,
        }
        sleep(SHORT.beat).await;
    }
}

#[tokio::test]
async fn a_claim_has_one_holder_until_it_is_released() {
    let (_folder, path) = place();
    let first = claimed(&on("a"), &path).await;
    for host in ["a", "b"] {
        let Attempt::Held(holder) = on(host).claim(&path, None).await.unwrap() else {
            panic!("two processes hold {}", path.display())
        };
        assert_eq!((holder.host.as_str(), holder.pid), ("a", std::process::id()));
        assert_eq!(on(host).holder(&path).unwrap().host, "a");
    }
    drop(first);
    assert!(!path.exists() && on("a").holder(&path).is_none());
    claimed(&on("b"), &path).await;
}

#[tokio::test]
async fn the_claim_of_a_dead_process_of_this_host_is_taken_over_at_once() {
    let (_folder, path) = place();
    abandoned(&path, "a");
    assert_eq!(on("a").holder(&path), None);
    let claim = claimed(&on("a"), &path).await;
    assert_eq!(read(&path).unwrap().unwrap().id, claim.id);
}

#[tokio::test]
async fn the_claim_of_a_dead_process_of_another_host_is_taken_over_after_a_while() {
    let (_folder, path) = place();
    let old = abandoned(&path, "b");
    assert_eq!(on("a").holder(&path), Some(old));
    let begun = Instant::now();
    assert!(matches!(judged(&on("a"), &path).await, Attempt::Claimed(_)));
    assert!(begun.elapsed() >= SHORT.stale + SHORT.settle);
}

#[tokio::test]
async fn a_host_that_restarted_is_another_host() {
    let (_folder, path) = place();
    abandoned(&path, "a");
    let restarted = Claimant { boot: "2".to_owned(), ..on("a") };
    let begun = Instant::now();
    assert!(matches!(judged(&restarted, &path).await, Attempt::Claimed(_)));
    assert!(begun.elapsed() >= SHORT.stale);
}

#[tokio::test]
async fn a_claim_that_its_host_renews_without_a_visible_lock_is_held() {
    let (_folder, path) = place();
    let claim = claimed(&on("b"), &path).await;
    claim.file.unlock().unwrap();
    let Attempt::Held(holder) = judged(&on("a"), &path).await else { panic!("taken over") };
    assert!(holder.host == "b" && holder.beat > 0, "{holder:?}");
}

#[tokio::test]
async fn a_file_that_was_never_written_is_taken_over_after_a_while() {
    let (_folder, path) = place();
    File::create(&path).unwrap();
    assert_eq!(on("a").holder(&path), None);
    assert!(matches!(on("a").claim(&path, None).await.unwrap(), Attempt::Unclear(_)));
    assert!(matches!(judged(&on("a"), &path).await, Attempt::Claimed(_)));
}

#[tokio::test]
async fn of_two_hosts_that_take_over_at_once_the_last_writer_has_the_claim() {
    let (_folder, path) = place();
    abandoned(&path, "c");
    let file = || File::options().read(true).write(true).open(&path).unwrap();
    let (a, b) = (on("a"), on("b"));
    let (first, second) = tokio::join!(a.take_over(&path, file()), b.take_over(&path, file()));
    let won = |attempt: &Attempt| matches!(attempt, Attempt::Claimed(_));
    assert!(!won(first.as_ref().unwrap()) && won(second.as_ref().unwrap()));
}

#[tokio::test]
async fn a_holder_learns_that_another_process_has_its_claim_and_leaves_that_claim_alone() {
    let (_folder, path) = place();
    let claim = claimed(&on("a"), &path).await;
    let other = abandoned(&path, "b");
    assert_eq!(claim.lost().await, other);
    drop(claim);
    assert_eq!(read(&path).unwrap(), Some(other));
}

#[tokio::test]
async fn a_holder_learns_that_its_claim_was_removed() {
    let (_folder, path) = place();
    let claim = claimed(&on("a"), &path).await;
    std::fs::remove_file(&path).unwrap();
    assert_eq!(claim.lost().await, Holder::default());
}

#[tokio::test]
async fn who_waits_has_the_claim_after_its_release() {
    let (_folder, path) = place();
    let first = claimed(&on("a"), &path).await;
    let (waiting, place) = (on("b"), path.clone());
    let waiter = tokio::spawn(async move { waiting.wait(&place).await });
    tokio::task::yield_now().await;
    drop(first);
    let second = waiter.await.unwrap().unwrap();
    assert_eq!(read(&path).unwrap().unwrap().id, second.id);
}

#[tokio::test]
async fn a_beat_changes_the_file_but_not_its_length() {
    let (_folder, path) = place();
    let claim = claimed(&on("a"), &path).await;
    let first = std::fs::read(&path).unwrap();
    let next = loop {
        let next = std::fs::read(&path).unwrap();
        if next != first {
            break next;
        }
        tokio::task::yield_now().await;
    };
    assert_eq!((first.len(), next.len()), (BYTES, BYTES));
    assert_eq!(read(&path).unwrap().unwrap().id, claim.id);
}
