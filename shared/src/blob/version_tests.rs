//! Headers of older versions, and the watch that they lack.

#![allow(clippy::unwrap_used)]

extern crate std;

use super::tests::{Aligned, Owned, file, forge, small, small_in_integers, small_with_watch};
use super::*;
use crate::watch::MAX_BLOCK;

/// A file of halves differs from one of version 2 in the version, the schema and the last three bytes of the header.
#[test]
fn version_2_is_read_as_a_network_in_halves() {
    let header = small();
    let owned = Owned::new(&header, 1);
    let new = file(&header, &owned);
    let mut buffer = [0; layout::MAX_HEADER_LEN];
    let len = postcard::to_slice(&header, &mut buffer).unwrap().len();
    let mut old = new.clone();
    old[layout::VERSION_AT] = 2;
    old[layout::HEADER_LEN_AT] = len as u8 - 3;
    old[layout::SCHEMA_AT..][..8].copy_from_slice(&layout::SCHEMA_KEY_2.to_le_bytes());
    let sections = [len, len - 3].map(|len| layout::Layout::new(len, &header.section_lens().unwrap()).unwrap());
    assert_eq!(sections[0], sections[1], "the bytes lie in the gap before the first section");
    let old = forge(old, 0, b"O");
    assert_eq!(Network::decode(Aligned::new(&old).bytes()).unwrap().into_header(), header);
    let mixed = forge(new, layout::VERSION_AT, &2u16.to_le_bytes());
    let error = BlobError::Schema { expected: layout::SCHEMA_KEY_2, found: SCHEMA_KEY };
    assert_eq!(Network::decode(Aligned::new(&mixed).bytes()).map(Network::into_header), Err(error));
}

/// A file of version 5 lacks the last byte of the header, that of the watch, one of version 4 that of the passes, too,
/// and one of version 3 the last byte of the scales of integers.
#[test]
fn headers_of_older_versions_are_read() {
    let [halves, integers] = [small(), small_in_integers()];
    for (header, version, less, key) in [
        (&halves, 3, 2, layout::SCHEMA_KEY_3),
        (&integers, 3, 3, layout::SCHEMA_KEY_3),
        (&halves, 4, 2, layout::SCHEMA_KEY_4),
        (&integers, 4, 2, layout::SCHEMA_KEY_4),
        (&halves, 5, 1, layout::SCHEMA_KEY_5),
        (&integers, 5, 1, layout::SCHEMA_KEY_5),
    ] {
        let mut old = file(header, &Owned::new(header, 1));
        let mut buffer = [0; layout::MAX_HEADER_LEN];
        let len = postcard::to_slice(header, &mut buffer).unwrap().len();
        let sections = [len, len - less].map(|len| layout::Layout::new(len, &header.section_lens().unwrap()).unwrap());
        assert_eq!(sections[0], sections[1], "the bytes lie in the gap before the first section");
        old[layout::VERSION_AT] = version;
        old[layout::HEADER_LEN_AT] = (len - less) as u8;
        old[layout::SCHEMA_AT..][..8].copy_from_slice(&key.to_le_bytes());
        let old = forge(old, 0, b"O");
        assert_eq!(&Network::decode(Aligned::new(&old).bytes()).unwrap().into_header(), header);
        // A byte more or less is no header of that version.
        for wrong in [len - less - 1, len - less + 1] {
            let wrong = forge(old.clone(), layout::HEADER_LEN_AT, &[wrong as u8]);
            let error = BlobError::Header { field: HeaderField::Encoding };
            assert_eq!(
                Network::decode(Aligned::new(&wrong).bytes()).map(Network::into_header),
                Err(error),
                "{version} {less}"
            );
        }
    }
}

/// Each number of the watch that no device can use, and statistics that are no numbers.
#[test]
fn an_impossible_watch_is_refused_by_name() {
    let good = small_with_watch();
    assert_eq!(good.check(), Ok(()));
    let refused = |change: fn(&mut Watching)| {
        let mut header = small_with_watch();
        change(header.watch.as_mut().unwrap());
        assert_eq!(header.check(), Err(BlobError::Header { field: HeaderField::Watch }), "{header:?}");
    };
    refused(|watch| watch.lenses = 2);
    refused(|watch| watch.lenses = crate::watch::MAX_LENSES as u8 + 1);
    refused(|watch| watch.block = 0);
    refused(|watch| watch.block = MAX_BLOCK + 1);
    refused(|watch| watch.least_light_dn = f32::NAN);
    refused(|watch| watch.log_odds = 0.0);
    let large = Header { frame: Size { rows: 4097, cols: 4096 }, ..good.clone() };
    assert_eq!(large.check(), Err(BlobError::Header { field: HeaderField::Watch }));
    // Blocks of 4 x 4 in 6 x 5 pixels; three lenses.
    let lens = good.section_lens().unwrap();
    assert_eq!((lens.watch, lens.statistics), (2 * 2 * 7 * 3, 9 * 8));
    let mut owned = Owned::new(&good, 1);
    owned.statistics[5].specimens = -1.0;
    let mut out = std::vec![0; encoded_len(&good).unwrap()];
    let error = encode(&good, &owned.weights(&good.sensor), &mut out);
    assert_eq!(error, Err(BlobError::Statistic { index: 5 }));
}
