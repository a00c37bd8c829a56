// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {KindId} from "./KindId.sol";
import {ServiceId, unpackService} from "./ServiceId.sol";

/// @notice What a committee has to know of an attempt that it judges, in one word: each further one that a contract returns
/// to another costs 150 gas.
/// From the lowest bit on: submitted (40 bits), kindId (8), serviceId (32), creator (160).
type Submission is uint256;

uint256 constant KIND = 40;
uint256 constant SERVICE = 48;
uint256 constant CREATOR = 80;

using {submitted, kindId, serviceId, creator} for Submission global;

/// @param by who posted the task
/// @param service that made the attempt
/// @param kind of the task
/// @param time when the proof came; 0 if the attempt was left undecided
function packSubmission(address by, ServiceId service, KindId kind, uint40 time) pure returns (Submission) {
    uint256 who = uint256(uint160(by)) << CREATOR | uint256(service.pack()) << SERVICE;
    return Submission.wrap(who | uint256(KindId.unwrap(kind)) << KIND | time);
}

/// @notice When the proof came, block time in seconds; 0 if it had a verdict before, and was left undecided.
function submitted(Submission submission) pure returns (uint40) {
    return uint40(Submission.unwrap(submission));
}

/// @notice The number of the task's kind, see IOrganization.numberOf.
function kindId(Submission submission) pure returns (KindId) {
    return KindId.wrap(uint8(Submission.unwrap(submission) >> KIND));
}

/// @notice The service that made the attempt.
function serviceId(Submission submission) pure returns (ServiceId) {
    return unpackService(uint32(Submission.unwrap(submission) >> SERVICE));
}

/// @notice Who posted the task.
function creator(Submission submission) pure returns (address) {
    return address(uint160(Submission.unwrap(submission) >> CREATOR));
}
