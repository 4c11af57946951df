#![allow(clippy::unwrap_used)]

use super::canvas::{Blend, Canvas};
use super::*;

const GRID: ObjectGrid = ObjectGrid { rows: 96, cols: 80, pixel_um: 2.8 };

#[test]
fn specimens_are_light_and_depend_on_seed_and_index_only() {
    for kind in Specimen::for_training() {
        let draw = |seed, index| kind.draw(&GRID, 0.0, &mut rng::stream(seed, "test", index));
        for index in 0..if Specimen::GENERAL.contains(&kind) { 400 } else { 8 } {
            let light = draw(3, index);
            assert_eq!(light.dim(), (96, 80));
            assert!(light.iter().all(|v| (0.0..=1.0).contains(v)), "{kind:?}");
            assert_eq!(light.fold(0.0f32, |m, v| m.max(*v)), 1.0, "{kind:?} {index}");
            // A specimen is neither a dot nor a sheet of light; tissue glows nearly everywhere, but not evenly.
            let level = if kind == Specimen::Section { 0.5 } else { 0.05 };
            let lit = light.iter().filter(|v| **v > level).count();
            // General kinds go to extremes.
            let expected = if Specimen::GENERAL.contains(&kind) { 2..96 * 80 + 1 } else { 20..96 * 80 * 3 / 4 };
            assert!(expected.contains(&lit), "{kind:?} {index}: {lit}");
        }
        assert_eq!(draw(3, 1), draw(3, 1));
        assert_ne!(draw(3, 1), draw(4, 1));
        assert_ne!(draw(3, 1), draw(3, 2));
    }
}

#[test]
fn a_disc_has_its_area_and_its_place() {
    let mut canvas = Canvas::new(&GRID);
    let (centre, radius) = ([10.3, -21.7], 9.0);
    canvas.disc(centre, radius, 1.0, Blend::Add);
    let light = canvas.into_light().mapv(f64::from);
    let area = light.sum() * GRID.pixel_um.powi(2);
    assert!((area / (std::f64::consts::PI * radius * radius) - 1.0).abs() < 0.02, "{area}");
    let mean = |axis: usize| {
        let weighted: f64 = light.indexed_iter().map(|((r, c), v)| v * [r, c][axis] as f64).sum();
        weighted / light.sum()
    };
    let expected = GRID.pixel_of_um(centre[0], centre[1]);
    assert!((mean(0) - expected[0]).abs() < 0.05 && (mean(1) - expected[1]).abs() < 0.05);
}

#[test]
fn a_disc_smaller_than_a_pixel_keeps_its_light() {
    let mut canvas = Canvas::new(&GRID);
    canvas.disc([1.0, 2.0], 0.7, 1.0, Blend::Add);
    let area = canvas.into_light().mapv(f64::from).sum() * GRID.pixel_um.powi(2);
    assert!((area / (std::f64::consts::PI * 0.49) - 1.0).abs() < 0.1, "{area}");
}

#[test]
fn a_shape_on_top_covers_what_lies_under_it() {
    let mut canvas = Canvas::new(&GRID);
    canvas.add(|_| 0.8);
    canvas.disc([0.0, 0.0], 20.0, 0.2, Blend::Over);
    canvas.point([-100.0, -80.0], 0.1);
    canvas.point([1e4, 0.0], 1.0);
    let light = canvas.into_light();
    assert!((light[[48, 40]] - 0.2).abs() < 0.01 && light[[0, 0]] == 0.8);
    assert_eq!(light.iter().filter(|v| (**v - 0.9).abs() < 1e-6).count(), 1);
}

#[test]
fn pictures_become_scenes() {
    let dir = tempfile::tempdir().unwrap();
    let config = |images| SceneConfig { specimens: Vec::new(), images, ..SceneConfig::default() };
    assert!(config(None).build().unwrap_err().to_string().contains("specimens"));
    assert!(config(Some(dir.path().into())).build().unwrap_err().to_string().contains("found none"));
    // A picture of 3 x 3 blocks as large as object pixels times two, on a pedestal of 100.
    let picture = ndarray::Array3::from_shape_fn((1, 192, 160), |(_, r, c)| {
        100.0 + if (r / 64, c / 54) == (1, 1) { 50.0 } else { 0.0 }
    });
    ommatidia_session::stack::write(&dir.path().join("a.tif"), picture.view()).unwrap();
    let scenes = config(Some(dir.path().into())).build().unwrap();
    let scene = scenes.draw(&GRID, 1, "test", 0);
    assert_eq!(scene.dim(), (96, 80));
    assert_eq!(scene.fold(1.0f32, |m, v| m.min(*v)), 0.0, "the pedestal is gone");
    std::fs::write(dir.path().join("b.png"), b"no picture").unwrap();
    assert!(config(Some(dir.path().into())).build().unwrap_err().to_string().contains("b.png"));
}

#[test]
fn worms_of_a_video_move_and_all_else_keeps_still() {
    let video = |kind, frames| {
        let config = SceneConfig { specimens: vec![kind], video_frames: frames, ..SceneConfig::default() };
        let scenes = config.build().unwrap();
        move |i| scenes.draw(&GRID, 5, "test", i)
    };
    let (worms, cells) = (video(Specimen::Worms, 4), video(Specimen::Cells, 4));
    assert_eq!(cells(0), cells(3));
    assert_ne!(cells(3), cells(4));
    // 20 ms move the body by less than its own thickness, and 40 move it further.
    let overlap = |a: &Array2<f32>, b: &Array2<f32>| (a * b).sum() / ((a * a).sum() * (b * b).sum()).sqrt();
    let frames = [0, 1, 2].map(worms);
    let (near, far) = (overlap(&frames[0], &frames[1]), overlap(&frames[0], &frames[2]));
    assert!(near < 0.999 && near > 0.6 && far < near, "{near} {far}");
    // The first frame of a video is the scene that would be drawn without one.
    let still = SceneConfig { specimens: vec![Specimen::Worms], ..SceneConfig::default() }.build().unwrap();
    assert_eq!(video(Specimen::Worms, 4)(4), still.draw(&GRID, 5, "test", 1));
    assert!(SceneConfig { video_frames: 0, ..SceneConfig::default() }.build().is_err());
}
