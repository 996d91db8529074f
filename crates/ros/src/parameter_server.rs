//! The parameter services of ROS 2: what `ros2 param` and rqt talk to.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pfd_parameters::{ParameterDescription, ParameterKind, Value};

use crate::messages::rcl::{
    DescribeParameters, DescribeParametersResponse, FloatingPointRange, GetParameterTypes, GetParameterTypesResponse,
    GetParameters, GetParametersResponse, IntegerRange, ListParameters, ListParametersRequest, ListParametersResponse,
    Parameter, ParameterDescriptor, ParameterEvent, ParameterValue, SetParameters, SetParametersAtomically,
    SetParametersAtomicallyResponse, SetParametersResponse, SetParametersResult,
};
use crate::{Clock, Node, Publisher, Qos, RosError};

/// Names a request may carry; larger ones are refused.
const MAX_NAMES: usize = 10_000;
/// History of `/parameter_events`, as in rcl.
const EVENT_DEPTH: i32 = 1000;

/// Called with all values after a change was checked; its error refuses the change.
pub type Apply = Box<dyn Fn(&BTreeMap<String, Value>) -> Result<(), String> + Send + Sync>;

/// What the server starts with.
pub struct ParameterServerOptions {
    /// All parameters of the node.
    pub descriptions: Vec<ParameterDescription>,
    /// Their values.
    pub values: Vec<(String, Value)>,
    /// Whether a parameter can change while the node runs.
    pub changeable: fn(&str) -> bool,
    /// Makes changes happen.
    pub apply: Apply,
}

/// Answers the parameter services. Clones share the values.
#[derive(Clone)]
pub struct ParameterServer {
    shared: Arc<Shared>,
}

struct Shared {
    descriptions: BTreeMap<String, ParameterDescription>,
    changeable: fn(&str) -> bool,
    apply: Apply,
    values: Mutex<BTreeMap<String, Value>>,
    events: Mutex<Option<Events>>,
}

struct Events {
    publisher: Publisher<ParameterEvent>,
    node: String,
    clock: Clock,
}

impl ParameterServer {
    /// A server that is not on the network yet.
    pub fn new(options: ParameterServerOptions) -> Self {
        let descriptions = options.descriptions.into_iter().map(|d| (d.name.clone(), d)).collect();
        Self {
            shared: Arc::new(Shared {
                descriptions,
                changeable: options.changeable,
                apply: options.apply,
                values: Mutex::new(options.values.into_iter().collect()),
                events: Mutex::new(None),
            }),
        }
    }

    /// Offers the services on a node.
    ///
    /// # Errors
    /// [`RosError`] when the middleware refuses.
    pub fn attach(&self, node: &mut Node) -> Result<(), RosError> {
        let publisher = node.publisher("/parameter_events", Qos::reliable(EVENT_DEPTH))?;
        let events = Events { publisher, node: node.names().node().to_string(), clock: node.clock().clone() };
        *self.shared.events.lock().unwrap_or_else(PoisonError::into_inner) = Some(events);
        let s = || self.clone();
        let (get, types, describe, list, set, set_all) = (s(), s(), s(), s(), s(), s());
        node.serve::<GetParameters>("~/get_parameters", move |r| GetParametersResponse { values: get.get(&r.names) })?;
        node.serve::<GetParameterTypes>("~/get_parameter_types", move |r| GetParameterTypesResponse {
            types: types.get(&r.names).iter().map(|v| v.r#type).collect::<Vec<u8>>().into(),
        })?;
        node.serve::<DescribeParameters>("~/describe_parameters", move |r| DescribeParametersResponse {
            descriptors: describe.describe(&r.names),
        })?;
        node.serve::<ListParameters>("~/list_parameters", move |r| list.list(&r))?;
        node.serve::<SetParameters>("~/set_parameters", move |r| SetParametersResponse {
            results: r.parameters.iter().map(|p| set.set(std::slice::from_ref(p))).collect(),
        })?;
        node.serve::<SetParametersAtomically>("~/set_parameters_atomically", move |r| SetParametersAtomicallyResponse {
            result: set_all.set(&r.parameters),
        })
    }

    fn values(&self) -> MutexGuard<'_, BTreeMap<String, Value>> {
        self.shared.values.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, names: &[String]) -> Vec<ParameterValue> {
        let values = self.values();
        let value = |name| {
            let description = self.shared.descriptions.get(name)?;
            Some(to_message(description.kind, values.get(name)?))
        };
        names.iter().take(MAX_NAMES).map(|name| value(name).unwrap_or_default()).collect()
    }

    fn describe(&self, names: &[String]) -> Vec<ParameterDescriptor> {
        let describe = |name: &String| match self.shared.descriptions.get(name) {
            Some(description) => descriptor(description, (self.shared.changeable)(name)),
            None => ParameterDescriptor { name: name.clone(), ..ParameterDescriptor::default() },
        };
        names.iter().take(MAX_NAMES).map(describe).collect()
    }

    fn list(&self, request: &ListParametersRequest) -> ListParametersResponse {
        let below = |name: &str, prefix: &str| {
            if prefix.is_empty() {
                Some(name.to_owned())
            } else {
                Some(name.strip_prefix(prefix)?.strip_prefix('.')?.to_owned())
            }
        };
        let depth = |name: &str| name.split('.').count() as u64;
        let selected = |name: &&String| {
            let all = [String::new()];
            let prefixes = if request.prefixes.is_empty() { &all[..] } else { &request.prefixes[..] };
            prefixes.iter().any(|prefix| {
                *name == prefix
                    || below(name, prefix).is_some_and(|rest| request.depth == 0 || depth(&rest) <= request.depth)
            })
        };
        let names: Vec<String> = self.shared.descriptions.keys().filter(selected).cloned().collect();
        let groups: BTreeSet<&str> = names.iter().filter_map(|n| n.rsplit_once('.').map(|(group, _)| group)).collect();
        let prefixes = groups.into_iter().map(str::to_owned).collect();
        ListParametersResponse { names, prefixes }
    }

    /// All or nothing.
    fn set(&self, parameters: &[Parameter]) -> SetParametersResult {
        match self.try_set(parameters) {
            Ok(()) => SetParametersResult { successful: true, reason: String::new() },
            Err(reason) => SetParametersResult { successful: false, reason },
        }
    }

    fn try_set(&self, parameters: &[Parameter]) -> Result<(), String> {
        let mut values = self.values();
        let mut changed = values.clone();
        for parameter in parameters {
            changed.insert(parameter.name.clone(), self.checked(parameter)?);
        }
        (self.shared.apply)(&changed)?;
        *values = changed;
        drop(values);
        self.announce(parameters);
        Ok(())
    }

    fn checked(&self, parameter: &Parameter) -> Result<Value, String> {
        let name = &parameter.name;
        let description =
            self.shared.descriptions.get(name).ok_or_else(|| format!("there is no parameter `{name}`"))?;
        if !(self.shared.changeable)(name) {
            return Err(format!("`{name}` can only be set when the node starts (-p {name}:=… or --params-file)"));
        }
        let value = from_message(&parameter.value).ok_or_else(|| format!("`{name}` cannot be unset"))?;
        description.check(&value).map_err(|reason| format!("`{name}`: {reason}"))?;
        Ok(value)
    }

    fn announce(&self, parameters: &[Parameter]) {
        let events = self.shared.events.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(events) = events.as_ref() else { return };
        events.publisher.publish(ParameterEvent {
            stamp: events.clock.now().into(),
            node: events.node.clone(),
            changed_parameters: parameters.to_vec(),
            ..ParameterEvent::default()
        });
    }
}

fn descriptor(description: &ParameterDescription, changeable: bool) -> ParameterDescriptor {
    let is_integer = description.kind == ParameterKind::Integer;
    let integer = |(low, high)| IntegerRange { from_value: low as i64, to_value: high as i64, step: 0 };
    let float = |(from_value, to_value)| FloatingPointRange { from_value, to_value, step: 0.0 };
    let choices = &description.choices;
    let constraints = if choices.is_empty() { String::new() } else { format!("one of: {}", choices.join(", ")) };
    ParameterDescriptor {
        name: description.name.clone(),
        r#type: type_code(description.kind),
        description: description.description.clone(),
        additional_constraints: constraints,
        read_only: !changeable,
        dynamic_typing: false,
        floating_point_range: description.range.filter(|_| !is_integer).map(float).into_iter().collect(),
        integer_range: description.range.filter(|_| is_integer).map(integer).into_iter().collect(),
    }
}

fn type_code(kind: ParameterKind) -> u8 {
    match kind {
        ParameterKind::Boolean => 1,
        ParameterKind::Integer => 2,
        ParameterKind::Double => 3,
        ParameterKind::String => 4,
        ParameterKind::BooleanArray => 6,
        ParameterKind::IntegerArray => 7,
        ParameterKind::DoubleArray => 8,
        ParameterKind::StringArray => 9,
    }
}

/// Null and what does not fit the kind become "not set".
fn to_message(kind: ParameterKind, value: &Value) -> ParameterValue {
    fn list<T>(value: &Value, element: impl Fn(&Value) -> Option<T>) -> Option<Vec<T>> {
        value.as_array()?.iter().map(element).collect()
    }
    let empty = ParameterValue { r#type: type_code(kind), ..ParameterValue::default() };
    let text = |v: &Value| v.as_str().map(str::to_owned);
    let filled = match kind {
        ParameterKind::Boolean => value.as_bool().map(|bool_value| ParameterValue { bool_value, ..empty }),
        ParameterKind::Integer => value.as_i64().map(|integer_value| ParameterValue { integer_value, ..empty }),
        ParameterKind::Double => value.as_f64().map(|double_value| ParameterValue { double_value, ..empty }),
        ParameterKind::String => text(value).map(|string_value| ParameterValue { string_value, ..empty }),
        ParameterKind::BooleanArray => {
            list(value, Value::as_bool).map(|bool_array_value| ParameterValue { bool_array_value, ..empty })
        }
        ParameterKind::IntegerArray => {
            list(value, Value::as_i64).map(|integer_array_value| ParameterValue { integer_array_value, ..empty })
        }
        ParameterKind::DoubleArray => {
            list(value, Value::as_f64).map(|double_array_value| ParameterValue { double_array_value, ..empty })
        }
        ParameterKind::StringArray => {
            list(value, text).map(|string_array_value| ParameterValue { string_array_value, ..empty })
        }
    };
    filled.unwrap_or_default()
}

/// `None` for "not set" and for byte arrays, which no parameter is.
fn from_message(value: &ParameterValue) -> Option<Value> {
    match value.r#type {
        1 => Some(value.bool_value.into()),
        2 => Some(value.integer_value.into()),
        3 => Some(value.double_value.into()),
        4 => Some(value.string_value.clone().into()),
        6 => Some(value.bool_array_value.clone().into()),
        7 => Some(value.integer_array_value.clone().into()),
        8 => Some(value.double_array_value.clone().into()),
        9 => Some(value.string_array_value.clone().into()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_parameters::NodeConfig;

    fn server() -> ParameterServer {
        let config = NodeConfig::default();
        ParameterServer::new(ParameterServerOptions {
            descriptions: pfd_parameters::describe::<NodeConfig>(),
            values: pfd_parameters::values(&config),
            changeable: |name| name != "network",
            apply: Box::new(|values| if values["map_frame"] == "" { Err("empty frame".into()) } else { Ok(()) }),
        })
    }

    fn double(name: &str, double_value: f64) -> Parameter {
        let value = ParameterValue { r#type: 3, double_value, ..ParameterValue::default() };
        Parameter { name: name.into(), value }
    }

    fn string(name: &str, text: &str) -> Parameter {
        let value = ParameterValue { r#type: 4, string_value: text.into(), ..ParameterValue::default() };
        Parameter { name: name.into(), value }
    }

    #[test]
    fn values_are_checked_before_they_are_taken() {
        let server = server();
        for (parameter, reason) in [
            (double("mask_timeout", -1.0), "out of range"),
            (double("map_frame", 1.0), "must be a string"),
            (double("nonsense", 1.0), "no parameter"),
            (string("network", "subnet"), "when the node starts"),
            (string("qos", "sometimes"), "none of: best_effort, reliable"),
            (string("map_frame", ""), "empty frame"),
            (Parameter { name: "map_frame".into(), ..Parameter::default() }, "cannot be unset"),
        ] {
            let result = server.set(std::slice::from_ref(&parameter));
            assert!(!result.successful && result.reason.contains(reason), "{}: {}", parameter.name, result.reason);
        }
        assert!(server.set(&[double("mask_timeout", 0.5)]).successful);
        assert!((server.get(&["mask_timeout".into()])[0].double_value - 0.5).abs() < 1e-12);
    }

    #[test]
    fn atomic_means_all_or_nothing() {
        let server = server();
        assert!(!server.set(&[double("mask_timeout", 0.7), double("sync_tolerance", 9.0)]).successful);
        assert!((server.get(&["mask_timeout".into()])[0].double_value - 0.2).abs() < 1e-12);
    }

    #[test]
    fn descriptions_and_lists() {
        let server = server();
        let described = &server.describe(&["mask_timeout".into(), "network".into(), "none".into()]);
        assert!(described[0].description.contains("seconds") && !described[0].read_only);
        assert!((described[0].floating_point_range[0].to_value - 60.0).abs() < 1e-12);
        assert!(described[1].read_only);
        assert_eq!(described[2].r#type, 0);
        let all = server.list(&ListParametersRequest::default());
        assert!(all.names.contains(&"publish_tf".to_owned()));
        let none = server.list(&ListParametersRequest { prefixes: vec!["camera".into()], depth: 0 });
        assert_eq!(none.names, Vec::<String>::new());
    }
}
