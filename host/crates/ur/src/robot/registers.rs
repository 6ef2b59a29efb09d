//! The registers: inputs that clients write, and who may write them; outputs that a program writes.

use std::collections::BTreeMap;

use crate::wire::{IN_USE, NOT_FOUND, Recipe, Setup, Value, input_type};

/// Values of the registers, and owners of the inputs.
#[derive(Debug, Default)]
pub(super) struct Registers {
    /// What was written last; it stays when its writer leaves.
    values: BTreeMap<String, Value>,
    owners: BTreeMap<String, u64>,
}

impl Registers {
    /// What was written last.
    pub(super) fn value(&self, name: &str) -> Option<Value> {
        self.values.get(name).copied()
    }

    /// An integer; 0 if nothing was written.
    pub(super) fn integer(&self, name: &str) -> i32 {
        match self.value(name) {
            Some(Value::Int32(value)) => value,
            _ => 0,
        }
    }

    /// A double; 0 if nothing was written.
    pub(super) fn double(&self, name: &str) -> f64 {
        match self.value(name) {
            Some(Value::Double(value)) => value,
            _ => 0.0,
        }
    }

    /// Sets an output register: a program does.
    pub(super) fn set(&mut self, name: &str, value: Value) {
        match self.values.get_mut(name) {
            Some(kept) => *kept = value,
            None => drop(self.values.insert(name.to_owned(), value)),
        }
    }

    /// Gives these inputs to a client, all or none. The answer has number 0 if one is unknown or another client has it.
    pub(super) fn claim(&mut self, client: u64, names: &[String], number: u8) -> (Setup, Option<Recipe>) {
        let mut recipe = Recipe::default();
        let types = names.iter().map(|name| {
            let Some(kind) = input_type(name) else {
                return NOT_FOUND;
            };
            if self.owners.get(name).is_some_and(|owner| *owner != client) {
                return IN_USE;
            }
            recipe.fields.push((name.clone(), kind));
            kind.name()
        });
        let types: Vec<String> = types.map(str::to_owned).collect();
        if names.is_empty() || recipe.fields.len() < names.len() {
            return (Setup { recipe: 0, types }, None);
        }
        self.owners.extend(names.iter().map(|name| (name.clone(), client)));
        (Setup { recipe: number, types }, Some(recipe))
    }

    /// Keeps what a client wrote.
    pub(super) fn write(&mut self, recipe: &Recipe, values: &[Value]) {
        for ((name, _), value) in recipe.fields.iter().zip(values) {
            self.set(name, *value);
        }
    }

    /// A client has left: others may have its inputs.
    pub(super) fn release(&mut self, client: u64) {
        self.owners.retain(|_, owner| *owner != client);
    }
}
