// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";
import {IProviders, Namers, Outcome} from "./IProviders.sol";

/// @dev Services that a provider may have at a time: so many tasks it holds at most. The organization answers for its own.
uint256 constant MAX_SERVICES = 8;

/// @notice A task names nobody, so that the policy chooses, or one service, or one provider.
enum Hire {
    None,
    Service,
    Provider
}

/// @notice By what services that wait are compared. Among equals of the cheapest the reputation decides, and among those of the
/// most reputable the price; then in both who has waited longest.
enum Choice {
    Oldest,
    Cheapest,
    MostReputable
}

/// @notice The provider sets Active, Paused and Retired. Only Active services get new tasks, and Retired is final. The
/// organization, or the terms after repeated failures, set Suspended; the provider can only retire the service then.
/// Short: what is left of the bond does not cover another penalty, until a case ends for which a part of it is set aside. The
/// service is Active again then.
enum ServiceState {
    None,
    Active,
    Paused,
    Retired,
    Suspended,
    Short
}

/// @param price what one task costs, in the token's smallest unit
/// @param taskId the task it is doing; 0 when it does none
/// @param place its place among the idle services: lower was there earlier; 0 when it does not wait
/// @param completed attempts that were accepted
/// @param rejected attempts that were rejected
/// @param expired attempts without a proof in time
/// @param reputation of its provider, in 64ths: the share of work well done in the work that others paid for, by value.
/// 32 for a newcomer. Waiting services are compared by eighths, as they were when they began to wait
/// @param bond what is left of the bond, in the token's smallest unit
/// @param penalty what a failed attempt takes from the bond; agreed at registration
/// @param maxFailures failures in a row of its provider that suspend it; 0 for no limit; agreed at registration
/// @param failures failures in a row until now of all services of the provider
/// @param autoAccept the provider accepts each task that the service is assigned
/// @param proven its provider is proven, see IProviders.isProven
/// @param namers who may post a task that names it
/// @param maxVoids creators of which more of 100 tasks that named somebody ended void may not; 0 for no such limit
struct Service {
    address provider;
    uint96 price;
    bytes32 kind;
    TaskId taskId;
    uint64 place;
    ServiceState state;
    uint32 completed;
    uint32 rejected;
    uint32 expired;
    uint8 reputation;
    uint96 bond;
    uint96 penalty;
    uint8 maxFailures;
    uint8 failures;
    bool autoAccept;
    bool proven;
    Namers namers;
    uint8 maxVoids;
}

/// @param provider whose service it was
/// @param payout who is paid: the provider's payout address
/// @param available whether the provider wants another task; it waits in its line for it if it was given a place there
/// @param penalty taken from the bond for the attempt that ended, or set aside
/// @param bond to be returned, because the service retired while it was at work
struct Release {
    address provider;
    address payout;
    bool available;
    uint256 penalty;
    uint256 bond;
}

/// @notice What a service that is free asks for.
/// @param kindId the number of what it does, see IOrganization.numberOf
/// @param price what one task costs, in the token's smallest unit
/// @param named if a task may wait that names the service, its number; if one may that names its provider, the provider's
/// address as a number; else 0
/// @param number of its provider, see IServiceManager.profile
/// @param proven it is offered the tasks for proven providers, too
struct Free {
    KindId kindId;
    uint256 price;
    uint160 named;
    uint32 number;
    bool proven;
}

/// @title Services: who does which work at which price, and which services wait for a task.
/// @notice A service does one task at a time. Its provider can change price and state meanwhile; both apply from the
/// next task on. A service keeps the terms that the organization had when it was registered. The task manager holds
/// its bond, as it holds all money.
interface IServiceManager {
    event ServiceRegistered(
        ServiceId indexed serviceId,
        address indexed provider,
        bytes32 indexed kind,
        uint256 price,
        bool autoAccept,
        string description
    );
    event ServiceUpdated(ServiceId indexed serviceId, uint256 price, ServiceState state);
    /// @notice With what is set aside, the bond does not cover another penalty: the service is Short.
    event BondRanShort(ServiceId indexed serviceId);
    /// @notice Its provider agreed to the judge that the kind has now.
    event ServiceAgreed(ServiceId indexed serviceId, KindId kindId);
    event ServiceSuspended(ServiceId indexed serviceId);
    /// @notice It is active, and waits in no line: its provider is not proven and rests, or has another service that waits or
    /// works. The provider puts it into line by updateService or wakeUp.
    event ServiceStoodBack(ServiceId indexed serviceId);
    /// @notice Its provider is asleep, and this service has missed an attempt, too: it is paused.
    event ServiceFellAsleep(ServiceId indexed serviceId);
    /// @notice The service is paused now, and its failures are forgiven.
    event ServiceReinstated(ServiceId indexed serviceId);

    error UnknownService(ServiceId serviceId);
    /// @notice A task names a service that does other work.
    error ServiceOfOtherKind(ServiceId serviceId, bytes32 kind);
    /// @notice A task names a provider that does no such work. The organization cannot be named: it has any number of
    /// services, so that a task names the service.
    error ProviderWithoutService(address provider, bytes32 kind);
    error NotProvider(ServiceId serviceId, address caller, address provider);
    error ServiceIsRetired(ServiceId serviceId);
    /// @notice The provider can only retire it.
    error ServiceIsSuspended(ServiceId serviceId);
    error ServiceNotSuspended(ServiceId serviceId, ServiceState state);
    error ServiceIsBusy(ServiceId serviceId, TaskId taskId);
    /// @notice A provider can set Active, Paused and Retired.
    error InvalidServiceState(ServiceState state);
    /// @notice The organization asks for a higher bond than the provider agreed to.
    error BondTooHigh(uint256 bond, uint256 maxBond);
    /// @notice A price is a multiple of `unit`, so that it can be compared in 57 bits, and at most `max`. The unit is a
    /// billionth of a token, or the token's smallest if it has 9 decimals or fewer.
    error InvalidPrice(uint256 price, uint256 unit, uint256 max);
    error ServiceNotIdle(ServiceId serviceId);
    /// @notice Retire one first. One that retired at work counts until its task ends.
    error TooManyServices(address provider, uint256 max);
    /// @notice The provider is not proven and has given work back, or missed it: its bonds wait.
    error BondIsLocked(ServiceId serviceId, uint256 until);
    error NotTaskManager(address caller);
    error NotOrganization(address caller);

    /// @notice Returns what is known of providers, in a contract of its own.
    function providers() external view returns (IProviders);

    /// @notice Offer work of a kind. The service is assigned the next open task that it can do, or waits for one.
    /// The caller pays the bond of the organization's terms, and approves the task manager for it before. A provider
    /// has up to MAX_SERVICES services; the organization has no limit.
    /// @param kind what is done, ASCII
    /// @param price what one task costs, in the token's smallest unit
    /// @param maxBond the highest bond that the caller agrees to, so that terms that change meanwhile surprise nobody
    /// @param autoAccept the caller accepts each task that the service is assigned. Otherwise it accepts each by
    /// ITaskManager.acceptTask, as is advisable where the parameters of tasks are free text.
    /// @param description free text; only in the event
    /// @return serviceId the number of the service, counted from 1
    function registerService(
        bytes32 kind,
        uint256 price,
        uint256 maxBond,
        bool autoAccept,
        string calldata description
    ) external returns (ServiceId serviceId);

    /// @notice Change price and state of a service from its next task on. A service that waits moves to the end of its
    /// line. A retired service's bond goes to its provider's payout address: at once when the service is idle, else
    /// when its task ends. That address may retire the service, too. A provider that is asleep cannot activate a
    /// service (see wakeUp).
    /// @param serviceId a service of the caller, or of whoever the caller is the payout address
    /// @param price what one task costs, in the token's smallest unit
    /// @param state Active, Paused or Retired
    function updateService(ServiceId serviceId, uint256 price, ServiceState state) external;

    /// @notice The caller agrees that its service gets tasks which the judge decides about that its kind has now. Until then
    /// it gets those that were posted under the judge before. Its bond stays.
    /// @param serviceId an idle service of the caller
    function agree(ServiceId serviceId) external;

    /// @notice The caller, who fell asleep or had to rest, takes part again. Its active services are put into line; those that
    /// were paused stay paused until it activates them.
    function wakeUp() external;

    /// @notice Returns a service as it is now. Reverts with UnknownService.
    function service(ServiceId serviceId) external view returns (Service memory);

    /// @notice Returns the account that does the service's tasks. It never changes. Reverts with UnknownService.
    function providerOf(ServiceId serviceId) external view returns (address);

    /// @notice Returns what a service that is free asks for.
    function wants(ServiceId serviceId) external view returns (Free memory);

    /// @notice Returns how tasks know the provider of a service.
    /// @return number of the provider: that of its first service
    /// @return proven whether it is proven
    /// @return isOffered whether tasks for proven providers may be offered to it: it is one, or there is none
    function profile(ServiceId serviceId) external view returns (uint32 number, bool proven, bool isOffered);

    /// @notice Returns a provider's service: the cheapest that is free and costs at most `maxPrice`, else any. Reverts
    /// with ProviderWithoutService.
    /// @param provider who offers it; the organization's services are not found
    /// @param kind what is done, ASCII
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @return serviceId its number
    /// @return all its services of the kind that are not over, 32 bits each
    function serviceOf(address provider, bytes32 kind, uint256 maxPrice)
        external
        view
        returns (ServiceId serviceId, uint256 all);

    /// @notice Returns how many services were ever registered, which is the last id.
    function serviceCount() external view returns (uint256);

    /// @notice Returns the best of the services that wait: each line's first MAX_LOOKS are looked at.
    /// @param kindId the number of what is done, see IOrganization.numberOf
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @param passed the providers that had the task and did not do it
    /// @param choice what is best
    /// @return serviceId 0 if no such service waits
    function bestIdle(KindId kindId, uint256 maxPrice, Passed passed, Choice choice)
        external
        view
        returns (ServiceId serviceId);

    /// @notice Give the service no new task until it is reinstated. A running task continues. Only the organization.
    function suspend(ServiceId serviceId) external;

    /// @notice Suspend all services of a provider. Those of the organization itself stay. Only the organization.
    /// @param provider who offers them
    function suspendServicesOf(address provider) external;

    /// @notice Vouch for a provider, or do so no longer. Only the organization.
    /// @param provider any account
    /// @param vouched whether it is proven without work
    function vouch(address provider, bool vouched) external;

    /// @notice End a suspension, and forgive the provider its failures. Only the organization.
    function reinstate(ServiceId serviceId) external;

    /// @notice Give a task to a service, if it is available, of this kind, and not too expensive. Only the task
    /// manager.
    /// @param serviceId the service that the policy chose, or that the task names; 0 for the one that has waited longest
    /// @param kindId the number of what is done, see IOrganization.numberOf
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @param passed the providers that had the task and did not do it
    /// @param taskId the task that it gets
    /// @param hired whether the task names the service, or its provider. It then waits for it, and `release` says so.
    /// Reverts with UnknownService or ServiceOfOtherKind if it would wait forever.
    /// @return taker the service; where the task names a provider maybe another one of it; 0 if there is none
    /// @return provider who does the task; 0 if the service does not fit, and nothing happened
    /// @return price the price of this task
    /// @return accepted whether the service accepts each task
    function reserve(
        ServiceId serviceId,
        KindId kindId,
        uint256 maxPrice,
        Passed passed,
        TaskId taskId,
        Hire hired
    ) external returns (ServiceId taker, address provider, uint256 price, bool accepted);

    /// @notice End the service's task. Only the task manager, which pays what this returns, and places the service.
    /// @param outcome how the attempt ended
    /// @param value what the service was paid, or would have been, in the token's smallest unit: so much the outcome
    /// counts for the reputation of its provider
    /// @param creator who posted the task. It does not count for its own provider, nor for one of the same owner
    /// @param place its place in line, if it is available and no task waits; 0 if one may wait
    function release(ServiceId serviceId, Outcome outcome, uint256 value, address creator, uint40 place)
        external
        returns (Release memory);

    /// @notice The case of an attempt is over whose service was released before. Only the task manager, which pays what this
    /// returns.
    /// @param serviceId the service that made the attempt
    /// @param outcome Completed, Rejected, GivenUp, Void or Unjudged
    /// @param value as for release
    /// @param creator as for release
    /// @param penalty what release set aside: lost with Rejected, and with GivenUp if the provider is not proven; else it is
    /// part of the bond again
    function conclude(
        ServiceId serviceId,
        TaskId taskId,
        Outcome outcome,
        uint256 value,
        address creator,
        uint96 penalty
    ) external returns (Release memory);

    /// @notice Let an available service wait behind the others of its kind. Only the task manager.
    /// @param place its place among the waiting services; a higher number than any before
    function enqueue(ServiceId serviceId, uint40 place) external;
}
