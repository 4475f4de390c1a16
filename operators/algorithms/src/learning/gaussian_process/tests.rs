#![allow(clippy::unwrap_used)]
use super::*;
use crate::solving::random::SplitMix64;

/// Samples of four numbers, and answers that a plane gives with some noise.
fn examples(count: usize) -> (Vec<Vec<f32>>, Vec<f64>) {
    let mut random = SplitMix64(7);
    let mut unit = move || random.unit() - 0.5;
    let sample = |_| -> Vec<f32> { (0..4).map(|_| unit() as f32).collect() };
    let samples: Vec<Vec<f32>> = (0..count).map(sample).collect();
    let plane = [1.0, -2.0, 0.5, 0.0];
    let answer = |sample: &Vec<f32>| {
        let noise = 0.3 * (37.0 * f64::from(sample[3])).sin();
        let products = sample.iter().zip(plane);
        let told: f64 = products.map(|(x, w)| f64::from(*x) * w).sum();
        (told + noise).signum()
    };
    let answers = samples.iter().map(answer).collect();
    (samples, answers)
}

fn matrix(samples: &[Vec<f32>]) -> DMatrix<f64> {
    DMatrix::from_fn(samples.len(), samples[0].len(), |row, at| {
        f64::from(samples[row][at])
    })
}

/// The textbook's way: kernel matrix between samples, inverted (equations 2.25, 2.26 and 5.8).
struct Dense {
    samples: DMatrix<f64>,
    answers: DVector<f64>,
    scale: f64,
    noise: f64,
}

impl Dense {
    fn kernel(&self) -> DMatrix<f64> {
        let count = self.samples.nrows();
        self.scale * &self.samples * self.samples.transpose()
            + self.noise * DMatrix::identity(count, count)
    }

    fn at(&self, sample: &[f32]) -> (f64, f64) {
        let sample = DVector::from_iterator(sample.len(), sample.iter().map(|x| f64::from(*x)));
        let inverse = self.kernel().try_inverse().unwrap();
        let near = self.scale * &self.samples * &sample;
        let mean = (near.transpose() * &inverse * &self.answers)[0];
        let known = (near.transpose() * inverse * &near)[0];
        (mean, self.scale * sample.norm_squared() - known)
    }

    fn log_likelihood(&self) -> f64 {
        let kernel = self.kernel();
        let fit = self
            .answers
            .dot(&(kernel.clone().try_inverse().unwrap() * &self.answers));
        let root = kernel.cholesky().unwrap();
        let half_log: f64 = root.l().diagonal().iter().map(|x| x.ln()).sum();
        -0.5 * fit - half_log
    }
}

fn dense(learnt: &LinearProcess, samples: &[Vec<f32>], answers: &[f64]) -> Dense {
    Dense {
        samples: matrix(samples),
        answers: DVector::from_column_slice(answers),
        scale: learnt.scale,
        noise: learnt.noise,
    }
}

#[test]
fn mean_and_variance_are_those_of_the_dense_formula() {
    let (samples, answers) = examples(30);
    let learnt = LinearProcess::learn(&samples, &answers).unwrap();
    let dense = dense(&learnt, &samples, &answers);
    // More than are multiplied together.
    let asked = examples(2 * TOGETHER + 3).0;
    let each = learnt.at_each(&asked);
    assert_eq!(each.len(), asked.len());
    for (sample, each) in asked.iter().zip(&each) {
        let (mean, variance) = dense.at(sample);
        for found in [each, &learnt.at(sample)] {
            assert!((found.mean - mean).abs() < 1e-9, "{} {mean}", found.mean);
            assert!((found.variance - variance).abs() < 1e-9);
        }
    }
}

#[test]
fn no_other_noise_or_scale_makes_the_answers_likelier() {
    let (samples, answers) = examples(30);
    let learnt = LinearProcess::learn(&samples, &answers).unwrap();
    let best = dense(&learnt, &samples, &answers).log_likelihood();
    // Less than a step of the noise that is tried may be won.
    for (scale, noise) in [
        (1.0, 2.0),
        (1.0, 0.5),
        (2.0, 1.0),
        (0.5, 1.0),
        (2.0, 2.0),
        (0.5, 0.5),
    ] {
        let mut other = dense(&learnt, &samples, &answers);
        other.scale *= scale;
        other.noise *= noise;
        assert!(other.log_likelihood() < best, "{scale} {noise}");
    }
}

#[test]
fn an_answer_where_nothing_is_known_teaches_most() {
    let samples = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.9, 0.0, 0.0]];
    let samples = samples.map(|sample| sample.to_vec()).to_vec();
    let learnt = LinearProcess::learn(&samples, &[1.0, -1.0, 0.9]).unwrap();
    let asked = [
        [1.0_f32, 0.0, 0.0],
        [0.0, 1.0, 0.2],
        [0.0, 1.0, 0.21],
        [0.0, 0.0, 1.0],
    ];
    let known = asked.map(|sample| learnt.at(&sample));
    let questions = learnt.questions(&known, &[1.0; 4], 4);
    let order: Vec<usize> = questions.iter().map(|(at, _)| *at).collect();
    // The third says almost what the second does: once one of them is answered, the fourth teaches more.
    assert_eq!((order[0], order[1]), (2, 3), "{questions:?}");
    assert!(questions.windows(2).all(|pair| pair[0].1 >= pair[1].1));
    assert!(known[0].mean > 0.5 && known[3].mean.abs() < 1e-9);
}

#[test]
fn what_is_left_out_is_as_if_it_had_never_been_there() {
    let (samples, answers) = examples(30);
    let learnt = LinearProcess::learn(&samples, &answers).unwrap();
    let left_out: Vec<&[f32]> = samples[4..7].iter().map(Vec::as_slice).collect();
    let found = learnt.left_out(&left_out, &answers[4..7]);
    let kept = |at: &usize| !(4..7).contains(at);
    let others: Vec<usize> = (0..30).filter(kept).collect();
    let rest = Dense {
        samples: matrix(&samples).select_rows(&others),
        answers: DVector::from_column_slice(&answers).select_rows(&others),
        ..dense(&learnt, &samples, &answers)
    };
    for (sample, found) in left_out.into_iter().zip(found) {
        assert!((rest.at(sample).0 - found).abs() < 1e-9);
    }
}

#[test]
fn what_cannot_be_learnt_from_is_told() {
    let learn =
        |samples: &[Vec<f32>], answers: &[f64]| LinearProcess::learn(samples, answers).unwrap_err();
    assert_eq!(learn(&[], &[]), LearningError::NoExamples);
    let one = vec![1.0_f32];
    assert_eq!(
        learn(std::slice::from_ref(&one), &[]),
        LearningError::Misshapen
    );
    assert_eq!(
        learn(&[one.clone(), vec![]], &[1.0, 1.0]),
        LearningError::Misshapen
    );
    assert_eq!(learn(&[vec![f32::NAN]], &[1.0]), LearningError::Misshapen);
    assert_eq!(learn(&[one], &[f64::NAN]), LearningError::Misshapen);
    let nothing = LinearProcess::learn(&vec![vec![0.0; 3]; 4], &[1.0; 4]).unwrap();
    assert!(nothing.at(&[1.0, 1.0, 1.0]).mean.abs() < 1e-9);
}
