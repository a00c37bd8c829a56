// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Choice} from "../interfaces/IServiceManager.sol";
import {Policy} from "./Policy.sol";

/// @title The service with the best reputation. Among equals the cheapest, then the one that has waited longest.
contract HighestReputation is Policy {
    function _choice() internal pure override returns (Choice) {
        return Choice.MostReputable;
    }
}
