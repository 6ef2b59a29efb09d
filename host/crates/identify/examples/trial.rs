//! Trials on real tables.
use spherecal_identify::study::{StudyRequest, load};
use spherecal_identify::*;
use std::time::Instant;

fn rng(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

fn with_sets(r: &Recordings, train: &[usize], test: &[usize]) -> Recordings {
    let mut out = r.clone();
    let mut obs = Vec::new();
    let mut samples = Vec::new();
    for (set, rows) in [(Set::Calibrate, train), (Set::Validate, test)] {
        for &i in rows {
            let mut o = r.experiment.observations[i].clone();
            o.set = set;
            obs.push(o);
            samples.push(r.samples[i].clone());
        }
    }
    out.experiment.observations = obs;
    out.samples = samples;
    out.course = None;
    out
}

fn one(name: &str, r: &Recordings, options: &EvaluateOptions) -> Option<bool> {
    let t = Instant::now();
    match evaluate(r, options, &mut |_| {}) {
        Err(e) => {
            println!("{name}: {e}");
            None
        }
        Ok(found) => {
            let c = &found.calibration;
            let of = |n: &str| {
                found
                    .judged
                    .as_ref()
                    .and_then(|j| j.model(n))
                    .map_or(f64::NAN, |m| m.errors().mean_mm)
            };
            let truth = of("calibrated");
            let w = found.verdict.expected_error_mm.map(|e| e.work);
            let e = found.verdict.expected_error_mm.map(|e| e.measured);
            let (mean, lo, hi) = e.map_or((f64::NAN, f64::NAN, f64::NAN), |e| {
                (e.mean, e.interval[0], e.interval[1])
            });
            let holds = lo <= truth && truth <= hi;
            println!(
                "{name:20} nominal {:.3} true {truth:.3} table {:.3} stated {mean:.3} [{lo:.3}, {hi:.3}] {} s/t {:.2} work {:.3} file {:.3} whole {:.3} P {:.3} | noise q {:.0} urad seat {:.0} point {:.0} um nu {:.1} use {} {:.2} s",
                of("nominal"),
                of("calibrated_table_only"),
                if holds { "holds" } else { "MISSES" },
                mean / truth,
                w.map_or(0.0, |w| w.mean),
                found.verdict.file_error_mm.map_or(0.0, |w| w.mean),
                found.verdict.expected_error_mm.map_or(0.0, |w| w.whole.mean),
                found.verdict.probability.unwrap_or(f64::NAN),
                c.noise.joint_rad * 1e6,
                c.noise.seating_m * 1e6,
                c.noise.point_m * 1e6,
                c.noise.student_t,
                found.verdict.may_be_used,
                t.elapsed().as_secs_f64()
            );
            if std::env::var("CAUSES").is_ok() {
                for f in &found.causes.findings {
                    println!("    {} harm {:.3} p {:.1}", f.words, f.harm_mm, f.log10_p);
                }
                for c in found.verdict.checks.iter().filter(|c| !c.passed && c.refuses) {
                    println!("    REFUSED {}", c.words);
                }
            }
            Some(holds)
        }
    }
}

fn main() {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let request = StudyRequest {
        robot: a[1].clone(),
        data: a[2].clone().into(),
        ignore_columns: std::env::var("IGNORE")
            .map(|s| s.split(",").map(str::to_owned).collect())
            .unwrap_or_default(),
        plate: a.get(3).filter(|s| *s != "-").map(Into::into),
        ..StudyRequest::default()
    };
    let loaded = load(&request, &mut |_| {}).expect("loaded");
    let r = loaded.recordings;
    let n = r.experiment.observations.len();
    let mut identify = Options::default();
    if let Ok(v) = std::env::var("ORD") {
        identify.harmonics = v.parse().unwrap();
    }
    let options = EvaluateOptions {
        identify,
        diagnose: std::env::var("NO").is_err(),
        ..EvaluateOptions::default()
    };
    let mut seed = 88_172_645_463_325_252_u64;
    let mut shuffled = || {
        let mut all: Vec<usize> = (0..n).collect();
        for i in (1..n).rev() {
            all.swap(i, (rng(&mut seed) % (i as u64 + 1)) as usize);
        }
        all
    };
    let mut held = Vec::new();
    match a[0].as_str() {
        "all" => {
            held.extend(one("all rows (cv)", &r, &options));
        }
        "cross" => {
            let r = match a.get(5) {
                Some(k) => {
                    let s = shuffled();
                    let m: usize = k.parse().unwrap();
                    with_sets(&r, &s[..m], &s[m..])
                }
                None => r.clone(),
            };
            // Fitted on the first table, judged on the second with its own base and tool.
            let other = load(
                &StudyRequest {
                    data: a[4].clone().into(),
                    ..request.clone()
                },
                &mut |_| {},
            )
            .expect("loaded")
            .recordings;
            let found = evaluate(
                &r,
                &EvaluateOptions {
                    cross_validate: false,
                    ..options.clone()
                },
                &mut |_| {},
            )
            .expect("fit");
            let (c, alone) = (found.calibration, found.geometry);
            println!("file stated {:?} P {:?}", alone.expected_error_mm, alone.better);
            for (name, rec) in [("own", &r), ("other", &other)] {
                let obs = &rec.experiment.observations;
                let onto: Vec<_> = obs
                    .iter()
                    .map(|o| match o.target {
                        Target::Point(p) => nalgebra::Vector3::from(p),
                        Target::Frame(ref p) => p.position,
                        _ => panic!(),
                    })
                    .collect();
                let judge = |f: &dyn Fn(&[f64], nalgebra::Vector3<f64>) -> nalgebra::Vector3<f64>| {
                    let mut t = nalgebra::Vector3::zeros();
                    let mut best = f64::NAN;
                    for _ in 0..25 {
                        let from: Vec<_> = obs.iter().map(|o| f(&o.q, t)).collect();
                        let b = fit_pose(&from, &onto).unwrap();
                        let mut h = nalgebra::DMatrix::zeros(9, 9);
                        let mut g = nalgebra::DVector::zeros(9);
                        best = 0.0;
                        for ((o, p), y) in obs.iter().zip(&from).zip(&onto) {
                            let e = y - b.point(p);
                            best += e.norm() * 1e3 / obs.len() as f64;
                            let mut a = nalgebra::DMatrix::zeros(3, 9);
                            for k in 0..3 {
                                let unit: nalgebra::Vector3<f64> = nalgebra::Vector3::ith(k, 1.0);
                                a.fixed_view_mut::<3, 1>(0, k)
                                    .copy_from(&(b.rotation * (f(&o.q, t + unit) - p)));
                                a.fixed_view_mut::<3, 1>(0, 3 + k).copy_from(&unit);
                                a.fixed_view_mut::<3, 1>(0, 6 + k)
                                    .copy_from(&unit.cross(&(b.rotation * p)));
                            }
                            h += a.transpose() * &a;
                            g += a.transpose() * nalgebra::DVector::from_column_slice(e.as_slice());
                        }
                        for k in 0..9 {
                            h[(k, k)] += 1e-9;
                        }
                        let x = h.lu().solve(&g).unwrap();
                        t += nalgebra::Vector3::new(x[0], x[1], x[2]);
                    }
                    best
                };
                let full = judge(&|q, t| c.tcp_m(q, None) + chain_rotation(&c.robot, q) * t);
                let geo = judge(&|q, t| pose(&alone.robot, &alone.tool, q) + chain_rotation(&alone.robot, q) * t);
                let nom = judge(&|q, t| {
                    pose(&r.experiment.robot, &r.experiment.tool, q) + chain_rotation(&r.experiment.robot, q) * t
                });
                println!("{name}: nominal {nom:.3} full {full:.3} geometry {geo:.3}");
            }
        }
        "place" => {
            let places: std::collections::BTreeSet<u32> = r.samples.iter().map(|s| s.place).collect();
            for p in places {
                let (te, tr): (Vec<usize>, Vec<usize>) = (0..n).partition(|i| r.samples[*i].place == p);
                held.extend(one(&format!("without place {p}"), &with_sets(&r, &tr, &te), &options));
            }
        }
        _ => {
            for size in [20, 40, 80, 160, 320, 640] {
                if size as f64 > 0.8 * n as f64 {
                    continue;
                }
                for draw in 0..3 {
                    let s = shuffled();
                    held.extend(one(
                        &format!("{size} rows, draw {draw}"),
                        &with_sets(&r, &s[..size], &s[size..(size + 500).min(n)]),
                        &options,
                    ));
                }
            }
            let labels = {
                // k-means over joint space
                let dof = r.experiment.robot.dof();
                let q = |i: usize| r.experiment.observations[i].q.clone();
                let s = shuffled();
                let mut c: Vec<Vec<f64>> = s[..6].iter().map(|i| q(*i)).collect();
                let mut label = vec![0; n];
                for _ in 0..30 {
                    for i in 0..n {
                        let d = |c: &Vec<f64>| -> f64 { c.iter().zip(q(i)).map(|(a, b)| (a - b).powi(2)).sum() };
                        label[i] = (0..6).min_by(|a, b| d(&c[*a]).total_cmp(&d(&c[*b]))).unwrap();
                    }
                    for k in 0..6 {
                        let own: Vec<usize> = (0..n).filter(|i| label[*i] == k).collect();
                        if own.is_empty() {
                            continue;
                        }
                        c[k] = (0..dof)
                            .map(|j| own.iter().map(|i| q(*i)[j]).sum::<f64>() / own.len() as f64)
                            .collect();
                    }
                }
                label
            };
            for k in 0..6 {
                let (te, tr): (Vec<usize>, Vec<usize>) = (0..n).partition(|i| labels[*i] == k);
                held.extend(one(&format!("region {k} left out"), &with_sets(&r, &tr, &te), &options));
            }
        }
    }
    println!("holds in {} of {}", held.iter().filter(|h| **h).count(), held.len());
}

fn pose(robot: &Robot, tool: &Tool, q: &[f64]) -> nalgebra::Vector3<f64> {
    spherecal_model::chain::Chain::unchecked(robot, tool).pose(q).position
}
fn chain_rotation(robot: &Robot, q: &[f64]) -> nalgebra::Matrix3<f64> {
    spherecal_model::chain::Chain::unchecked(robot, &Tool::default())
        .pose(q)
        .rotation
        .into()
}
