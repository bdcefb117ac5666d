//! Bias currents and voltages of the DAVIS346 chip: registers 5.0 to 5.36, 16 bits each.
//!
//! ```text
//! coarse-fine     0 CCC FFFFFFFF L T S E     coarse 0–7, fine 0–255, L current level normal,
//!                                            T type N, S sex N, E enabled
//! voltage (VDAC)  0000000 CCC VVVVVV         current 0–7, voltage 0–63
//! shifted source  RRRRRR rrrrrr LL MM        regulator, reference, level, mode
//! ```
//! The current of a coarse-fine bias is about master × fine / 255, with master 11 pA, 94 pA, 756 pA, 6.054 nA, 48.437
//! nA, 387.5 nA, 3.1 µA, 24.8 µA for coarse 0 to 7.

use crate::registers::Register;

/// Master currents of coarse 0 to 7, in amperes.
pub const MASTER_CURRENTS: [f64; 8] = [11e-12, 94e-12, 756e-12, 6.054e-9, 48.437e-9, 387.5e-9, 3.1e-6, 24.8e-6];

/// A coarse-fine bias, which sets the current of a transistor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoarseFine {
    /// Index of the master current, 0..=7.
    pub coarse: u8,
    /// Fraction of the master current in 255ths, 0..=255.
    pub fine: u8,
    /// `false` if the bias is off.
    pub enabled: bool,
    /// `true` for an N-type transistor, `false` for P.
    pub sex_n: bool,
    /// `true` for normal, `false` for cascode.
    pub type_normal: bool,
    /// `true` for the normal current level, `false` for low.
    pub current_level_normal: bool,
}

impl CoarseFine {
    /// Unpacks a register value.
    pub const fn parse(value: u16) -> Self {
        Self {
            coarse: (value >> 12 & 7) as u8,
            fine: (value >> 4 & 0xFF) as u8,
            enabled: value & 1 != 0,
            sex_n: value & 2 != 0,
            type_normal: value & 4 != 0,
            current_level_normal: value & 8 != 0,
        }
    }

    /// Returns the register value.
    pub const fn emit(self) -> u16 {
        (self.coarse as u16 & 7) << 12
            | (self.fine as u16) << 4
            | (self.current_level_normal as u16) << 3
            | (self.type_normal as u16) << 2
            | (self.sex_n as u16) << 1
            | self.enabled as u16
    }

    /// Returns the approximate current in amperes.
    pub fn current(self) -> f64 {
        let master = MASTER_CURRENTS.get(usize::from(self.coarse & 7)).copied().unwrap_or(0.0);
        if self.enabled { master * f64::from(self.fine) / 255.0 } else { 0.0 }
    }
}

/// Number of biases of the chip.
pub const COUNT: usize = 28;

macro_rules! biases {
    ($($(#[doc = $documentation:literal])* $name:ident = $address:literal, $default:literal;)*) => {
        /// A bias of the DAVIS346, by its register 5.n.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum Bias {
            $($(#[doc = $documentation])* $name = $address,)*
        }

        impl Bias {
            /// All biases, in the order in which they are written.
            pub const ALL: [Self; COUNT] = [$(Self::$name),*];
        }

        const DEFAULTS: [u16; COUNT] = [$($default),*];
    };
}

biases! {
    /// Voltage at which a frame pixel overflows.
    ApsOverflowLevel = 0, 0x019B;
    /// Cascode voltage of the frame pixels.
    ApsCas = 1, 0x0195;
    /// Upper reference of the converter.
    AdcRefHigh = 2, 0x01E0;
    /// Lower reference of the converter.
    AdcRefLow = 3, 0x01C1;
    /// Test input of the converter.
    AdcTestVoltage = 4, 0x01D5;
    /// Local buffer.
    LocalBufBn = 8, 0x5A4F;
    /// Follower of the pads; switched off.
    PadFollBn = 9, 0x7D7E;
    /// Differencing amplifier: both thresholds are relative to it.
    DiffBn = 10, 0x427F;
    /// Threshold of ON events: more current, fewer events.
    OnBn = 11, 0x5FFF;
    /// Threshold of OFF events: less current, fewer events.
    OffBn = 12, 0x401F;
    /// Inverter of the pixel.
    PixInvBn = 13, 0x690F;
    /// Photoreceptor: more current, more bandwidth.
    PrBp = 14, 0x23AD;
    /// Photoreceptor's source follower: more current, more bandwidth.
    PrSfBp = 15, 0x110D;
    /// Refractory period: more current, shorter period.
    RefrBp = 16, 0x419D;
    /// Readout buffer of the frame pixels.
    ReadoutBufBp = 17, 0x614D;
    /// Source follower of the frame readout.
    ApsRoSfBn = 18, 0x6DBF;
    /// Comparator of the converter.
    AdcCompBp = 19, 0x514D;
    /// Column selection.
    ColSelLowBn = 20, 0x001F;
    /// Buffer of the digital-analogue converter.
    DacBufBp = 21, 0x63CD;
    /// Time-out of the column arbiter.
    LcolTimeoutBn = 22, 0x531F;
    /// Pull-down of the event bus.
    AePdBn = 23, 0x65BF;
    /// Pull-up of the event bus, columns.
    AePuXBp = 24, 0x450D;
    /// Pull-up of the event bus, rows.
    AePuYBp = 25, 0x798D;
    /// Refractory period of the test neuron.
    IfRefrBn = 26, 0x5FFF;
    /// Threshold of the test neuron.
    IfThrBn = 27, 0x5FFF;
    /// Buffer of all biases.
    BiasBuffer = 34, 0x5FEF;
    /// Shifted source, P.
    Ssp = 35, 0x8410;
    /// Shifted source, N.
    Ssn = 36, 0x8410;
}

impl Bias {
    /// Returns the register of the bias.
    pub const fn register(self) -> Register {
        Register::new(5, self as u8)
    }
}

/// Values of all biases. The default is libcaer's for the DAVIS346.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Biases([u16; COUNT]);

impl Default for Biases {
    fn default() -> Self {
        Self(DEFAULTS)
    }
}

impl Biases {
    /// Returns the register value of `bias`.
    pub fn get(&self, bias: Bias) -> u16 {
        self.iter().find(|&(other, _)| other == bias).map_or(0, |(_, value)| value)
    }

    /// Sets the register value of `bias`; [`CoarseFine::emit`] packs a current into one.
    pub fn set(&mut self, bias: Bias, value: u16) {
        for (other, place) in Bias::ALL.iter().zip(&mut self.0) {
            if *other == bias {
                *place = value;
            }
        }
    }

    /// Returns all biases with their values, in the order in which they are written.
    pub fn iter(&self) -> impl Iterator<Item = (Bias, u16)> + '_ {
        Bias::ALL.iter().copied().zip(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarse_and_fine_fields_are_parsed_and_emitted() {
        let diff = CoarseFine::parse(Biases::default().get(Bias::DiffBn));
        assert_eq!((diff.coarse, diff.fine, diff.enabled, diff.sex_n), (4, 39, true, true));
        assert!((diff.current() - 48.437e-9 * 39.0 / 255.0).abs() < 1e-15);
        let follower = CoarseFine::parse(Biases::default().get(Bias::PadFollBn));
        assert_eq!((follower.coarse, follower.fine, follower.enabled), (7, 215, false));
        assert_eq!(follower.current(), 0.0);
        let receptor = CoarseFine::parse(Biases::default().get(Bias::PrBp));
        assert_eq!((receptor.coarse, receptor.fine, receptor.sex_n), (2, 58, false));
        for value in 0..0x8000 {
            assert_eq!(CoarseFine::parse(value).emit(), value);
        }
    }
}
