// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice The number of a service, counted from 1.
type ServiceId is uint256;

/// @dev No service has this number.
ServiceId constant NO_SERVICE = ServiceId.wrap(0);

using {equal as ==, differ as !=, pack} for ServiceId global;

function equal(ServiceId a, ServiceId b) pure returns (bool) {
    return ServiceId.unwrap(a) == ServiceId.unwrap(b);
}

function differ(ServiceId a, ServiceId b) pure returns (bool) {
    return ServiceId.unwrap(a) != ServiceId.unwrap(b);
}

/// @dev As it is stored beside other values. ServiceManager registers no service whose number needs more bits.
function pack(ServiceId id) pure returns (uint32) {
    return uint32(ServiceId.unwrap(id));
}

/// @dev What `pack` has packed, and what a TaskRequest names.
function unpackService(uint32 packed) pure returns (ServiceId) {
    return ServiceId.wrap(packed);
}
