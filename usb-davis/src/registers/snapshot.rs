//! The values of many registers at one time.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Clocks, Register};

/// Registers and their values, in order of module and parameter. As JSON a list of
/// `[module, parameter, value]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<(u8, u8, u32)>", into = "Vec<(u8, u8, u32)>")]
pub struct RegisterSnapshot(BTreeMap<Register, u32>);

impl RegisterSnapshot {
    /// Returns the value of `register`, if it is known.
    pub fn get(&self, register: Register) -> Option<u32> {
        self.0.get(&register).copied()
    }

    /// Returns the 64-bit counter whose upper half is `register`.
    pub fn counter(&self, register: Register) -> Option<u64> {
        Some(u64::from(self.get(register)?) << 32 | u64::from(self.get(register.next())?))
    }

    /// Sets the value of `register`.
    pub fn set(&mut self, register: Register, value: u32) {
        self.0.insert(register, value);
    }

    /// Returns all registers with their values, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Register, u32)> + '_ {
        self.0.iter().map(|(&register, &value)| (register, value))
    }

    /// Returns the number of known registers.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns `true` if no register is known.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the clock rates.
    pub fn clocks(&self) -> Clocks {
        Clocks::from_registers(|register| self.get(register))
    }
}

impl FromIterator<(Register, u32)> for RegisterSnapshot {
    fn from_iter<I: IntoIterator<Item = (Register, u32)>>(registers: I) -> Self {
        Self(registers.into_iter().collect())
    }
}

impl From<Vec<(u8, u8, u32)>> for RegisterSnapshot {
    fn from(list: Vec<(u8, u8, u32)>) -> Self {
        list.into_iter().map(|(module, parameter, value)| (Register::new(module, parameter), value)).collect()
    }
}

impl From<RegisterSnapshot> for Vec<(u8, u8, u32)> {
    fn from(snapshot: RegisterSnapshot) -> Self {
        snapshot.iter().map(|(register, value)| (register.module, register.parameter, value)).collect()
    }
}
