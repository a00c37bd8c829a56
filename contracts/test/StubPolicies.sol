// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {Choice, IServiceManager} from "../src/interfaces/IServiceManager.sol";
import {ITaskQueues} from "../src/interfaces/ITaskQueues.sol";
import {KindId} from "../src/types/KindId.sol";
import {Passed} from "../src/types/Passed.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";

/// @notice How a policy answers: with what it was told, or not as a policy should.
enum Way {
    Answers,
    Reverts,
    BurnsGas,
    ReturnsTooMuch,
    ReturnsTooLittle,
    ReturnsNothing
}

/// @notice Chooses what it was told, whoever asks, or misbehaves.
contract StubPolicy is IMatchingPolicy {
    Way public way;
    uint256 public chosen;

    constructor(Way way_, uint256 chosen_) {
        (way, chosen) = (way_, chosen_);
    }

    function tell(Way way_, uint256 chosen_) external {
        (way, chosen) = (way_, chosen_);
    }

    function serviceFor(IServiceManager, KindId, uint256, Passed) external view virtual returns (ServiceId) {
        return ServiceId.wrap(_answer());
    }

    function taskFor(ITaskQueues, IServiceManager, KindId, ServiceId, uint256)
        external
        view
        returns (TaskId)
    {
        return TaskId.wrap(_answer());
    }

    function _answer() private view returns (uint256) {
        require(way != Way.Reverts, "no");
        while (way == Way.BurnsGas) {}
        if (way == Way.Answers) return chosen;
        uint256 size = way == Way.ReturnsTooMuch ? 400_000 : way == Way.ReturnsTooLittle ? 31 : 0;
        assembly {
            return(0, size)
        }
    }
}

/// @notice The same for services that become free. Tasks get the service that has waited longest.
contract TaskStubPolicy is StubPolicy {
    constructor() StubPolicy(Way.Answers, 0) {}

    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        override
        returns (ServiceId)
    {
        return services.bestIdle(kindId, reward, passed, Choice.Oldest);
    }
}

/// @notice Answers right, after it has spent most of what it may. Its third task goes first.
contract SlowPolicy is IMatchingPolicy {
    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        returns (ServiceId)
    {
        _spend();
        return services.bestIdle(kindId, reward, passed, Choice.Oldest);
    }

    function taskFor(ITaskQueues, IServiceManager, KindId, ServiceId, uint256)
        external
        view
        returns (TaskId)
    {
        _spend();
        return TaskId.wrap(3);
    }

    function _spend() private view {
        uint256 end = gasleft() - 450_000;
        while (gasleft() > end) {}
    }
}

/// @notice Of the tasks that wait it chooses any, or one that does not wait or pays too little, or fails.
contract UnrulyPolicy is IMatchingPolicy {
    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        returns (ServiceId)
    {
        return services.bestIdle(kindId, reward, passed, Choice.Oldest);
    }

    function taskFor(ITaskQueues queues, IServiceManager, KindId kindId, ServiceId serviceId, uint256 price)
        external
        view
        returns (TaskId)
    {
        // The oldest of all, as a number of the past.
        uint256 count = TaskId.unwrap(queues.oldestOpen(serviceId, kindId, 0)) + 8;
        uint256 seed = uint256(keccak256(abi.encode(block.timestamp, serviceId, price, count)));
        require(seed % 16 != 0, "no");
        if ((seed >> 8) % 2 == 0) {
            return queues.oldestOpen(serviceId, kindId, price + (seed >> 96) % 100 ether);
        }
        return TaskId.wrap((seed >> 16) % (count + 2));
    }
}
