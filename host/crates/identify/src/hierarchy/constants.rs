//! Every constant that decides what an identification finds: value, unit and source, and what moves with it where
//! that was measured.

/// Factor by which the size of a group may differ from its ordinary size (1 sigma of the logarithm).
///
/// * Lengths, twists, tilt: makers differ by about 3 (KUKA machines to 0.2 mm, printed arms to 1 mm).
/// * Offsets: mastering errors of 0.1 mrad to 30 degrees are ordinary, so a factor of 10.
/// * Scale: from a laser tracker, 1e-6, to a camera, 1e-3, and a mistake, 1e-2: 10.
/// * Tool: from a machined adapter to one that was measured by hand, 10.
/// * Compliance, bending: 3e-6 (catalogue of strain wave gears) to 6e-5 rad/(N m) (a real iiwa 7), 5.
/// * Eccentricity and ripple: as lengths. All joints of an arm have one size: with one of its own, a joint that moves little
///   takes what belongs to others (first orders of 7 mrad on a real UR10, ripple of 0.4 mrad in a simulated arm) and predicts
///   wrongly elsewhere. A factor of 1.5 in place of 3 moves no prediction by more than 5 %.
/// * Seats: kinematic couplings repeat to 0.1 to 3 um, printed sockets that are set by hand to 50 um, 10.
pub(crate) const FACTORS: Factors = Factors {
    made: 3.0,
    wide: 10.0,
    compliance: 5.0,
};

/// See [`FACTORS`].
pub(crate) struct Factors {
    /// Lengths, twists, tilt, eccentricity and ripple.
    pub(crate) made: f64,
    /// Offsets, tool, scale and seats.
    pub(crate) wide: f64,
    /// Compliance and bending; what all compliances have in common, where a load is tested.
    pub(crate) compliance: f64,
}

/// Orders of the eccentricity: beyond, what a gear does is ripple. With 2 in place of 4 no prediction moved by more than 5 %.
pub(crate) const ECCENTRIC_ORDERS: usize = 4;
/// Ordinary eccentricity of order 1 and ripple of every order (rad). Encoders are centred to some hundredths of a
/// millimetre on discs of some centimetres; strain wave gears ripple by some seconds of arc (a real UR10: 50 µrad).
/// The ripple was halved and the eccentricity doubled on the real tables: no prediction moved by more than 2 %.
pub(crate) const HARMONICS: (f64, f64) = (1e-4, 2e-5);

/// Ordinary error of a joint by one order of another joint's angle (rad), and the weights of its orders: those of a smooth
/// function over 1 rad, `exp(-k²/4)`, of which two hold 98 % of the variance. The residuals of a real UR10 correlate by 0.4 within
/// 0.35 rad and by 0.2 at 1 rad.
pub(crate) const CROSS_RAD: f64 = 2e-5;
/// See [`CROSS_RAD`].
pub(crate) const CROSS_WEIGHTS: [f64; 2] = [0.779, 0.368];
/// Logarithms of that size, by the ordinary one, among which the best is looked for, and of the share of the white noise that is
/// left. The first reaches three standard deviations of its hyperprior (a factor of 3, as of ripple); a share of 14 % was never met.
pub(crate) const CROSS_RANGES: [(f64, f64); 2] = [(-3.3, 3.3), (-2.0, 0.1)];
/// Most joints of an arm whose joints have such errors: their number grows with the square, and a chain of more is no arm alone.
pub(crate) const CROSS_JOINTS: usize = 8;

/// Ordinary seat of a coupling about the others (m, each axis): kinematic couplings repeat to 0.1 to 3 µm.
pub(crate) const SEAT_M: f64 = 3e-6;
/// Degrees of freedom of the seats: few sit badly, and those far off.
pub(crate) const SEATS_NU: f64 = 3.0;
/// Fewest rows of a coupling on average from which its seat is estimated.
pub(crate) const ROWS_PER_SEAT: usize = 6;

/// Hyperprior of the joints' noise: median in rad (gear and encoder noise of data sheets) and factor.
/// The factor is wide, since exact encoders and printed gears are both ordinary.
pub(crate) const JOINT_NOISE: (f64, f64) = (5e-5, 10.0);
/// Ordinary noise of the whole tool that no joint makes: shifts (m) and turns (rad), 1 sigma each axis. A real IRB 120 has 3e-5
/// and 4e-4; its hyperprior is as wide as an instrument's.
pub(crate) const TOOL_NOISE: [f64; 2] = [3e-5, 1e-4];
/// Factor of the hyperprior of an instrument's noise about what the options say.
pub(crate) const INSTRUMENT_FACTOR: f64 = 10.0;
/// Hyperprior of the degrees of freedom of Student's t: median and factor. Robot tables have tails of 3 to 10.
pub(crate) const TAILS: (f64, f64) = (6.0, 2.5);
/// Range of the degrees of freedom: fewer than 2.5 have no variance to speak of, more than 100 are normal.
pub(crate) const TAILS_RANGE: (f64, f64) = (2.5, 100.0);
/// Least noise of a joint (rad) and of an instrument (m, or rad of an orientation): the resolution of the best.
pub(crate) const LEAST_NOISE: (f64, f64) = (1e-7, 1e-6);

/// Size of the scale from which a second search begins: a wrong unit, temperature or stylus of the instrument, 0.3 %.
pub(crate) const WRONG_SCALE: f64 = 3e-3;
/// Largest scale that is a mistake of the instrument; beyond, the search has shrunk the arm.
pub(crate) const LARGEST_SCALE: f64 = 0.03;
/// Logarithm of the evidence by which a wrong scale must be better: very strong (Kass and Raftery 1995).
pub(crate) const SCALE_EVIDENCE: f64 = 5.0;
/// Median residual with a wrong scale, as a share of that without it, up to which it explains the rows.
pub(crate) const SCALE_RESIDUAL: f64 = 1.1;
/// Standard deviations beyond which a scale is called wrong: by chance once in 1.7 million.
pub(crate) const SCALE_SIGMAS: f64 = 5.0;

/// Rounds before the sizes are updated: Gauss-Newton must reach the data first.
pub(crate) const FIRST_ROUNDS: usize = 3;
/// Most rounds. Trials needed 8 to 20.
pub(crate) const ROUNDS: usize = 60;
/// Change of every logarithm of a size at which the search ends.
pub(crate) const SETTLED: f64 = 0.01;
/// Most fits without the causes that were named before, and the change of every cause, as a share of its standard deviation, from
/// which they are the last.
pub(crate) const CAUSE_ROUNDS: usize = 6;
pub(crate) const CAUSE_STAYS: f64 = 0.1;
/// Distance of two sets of joint angles (rad) up to which postures are alike: within it the Jacobian turns by less than a third.
/// The residuals of a real UR10 correlate by 0.4 there, and by 0.2 at 1 rad.
pub(crate) const ALIKE_RAD: f64 = 0.35;
/// Rows that stand for all when postures are compared: more only cost time.
pub(crate) const ALIKE_ROWS: usize = 2_000;
/// Rows from which the noise's degrees of freedom are computed, spread evenly: more hardly change them.
pub(crate) const LEVERAGE_ROWS: usize = 200;

/// Draws of a statement.
pub(crate) const DRAWS: usize = 400;
/// Postures of a region.
pub(crate) const POSTURES: usize = 200;
/// Leverage beyond which a row alone determines an unknown, as the only row of a place does: it tells nothing of its own
/// prediction.
pub(crate) const LARGEST_LEVERAGE: f64 = 0.9;
/// Fewest rows that were measured apart whose postures are a region.
pub(crate) const FEWEST_JUDGES: usize = 5;
/// What errors outside of the model add to a stated error: mean and standard deviation of its logarithm, among the rows'
/// postures and far from them. Found on splits of five real data sets by rows and by regions (docs/real-data.md).
pub(crate) const MODEL_ERROR: [(f64, f64); 2] = [(0.06, 0.12), (0.2, 0.3)];
/// Share of the rows that count as among the others: a posture whose nearest row is farther than that of so many rows is far
/// from them.
pub(crate) const AMONG: f64 = 0.95;
/// First guess of what the geometry of a file cannot follow of the full model, 1 sigma each axis (m): gear and encoder
/// errors of 1e-4 rad at a metre, and some of the deflection. A second fit takes what the first leaves.
pub(crate) const FILE_MISFIT_M: f64 = 3e-4;
/// Share of the expected error up to which a named cause is no remark: squares add, so it makes the error 0.5 % larger.
pub(crate) const NEGLIGIBLE: f64 = 0.1;
/// Probability from which a result may be used. The convention of a 95 % interval.
pub(crate) const SURE: f64 = 0.95;
/// Median residual of a fit, as a share of the arm's length, beyond which the rows are not those of this robot: 10 mm of an arm
/// of 1 m. Printed arms leave a fifth of it; a wrong order of the joints leaves a tenth of the arm.
pub(crate) const HOPELESS: f64 = 0.01;
/// Standard deviations of the hyperprior from which lengths or twists are those of another arm, or of another unit: 40 mm and
/// 40 mrad. Dropped and printed arms stay below two.
pub(crate) const STRANGE: f64 = 4.0;
