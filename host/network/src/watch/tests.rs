#![allow(clippy::unwrap_used)]
use super::*;

#[test]
#[ignore]
fn explore() {
    let i = Instrument::read(std::path::Path::new("/tmp/watch/relay.instrument")).unwrap();
    let t = std::time::Instant::now();
    let watch = WatchMaps::of(&i, 5).unwrap();
    eprintln!("{} {} {:?}", watch.block, watch.weights.len() * 2, t.elapsed());
}
